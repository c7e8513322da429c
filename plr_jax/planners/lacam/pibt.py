"""One step of a whole team: priority inheritance with backtracking (PIBT).

Robots choose in the order of their priorities. Each takes its best primitive that keeps clear of what others have
chosen. Robots that have not chosen may be asked to make way: they choose next, and where one finds nothing, the
primitive is given up. So whoever has not chosen can stay where it is, and without constraints there always is a step.

References:
    Okumura et al., "Priority inheritance with backtracking for iterative multi-agent path finding", 2022. There,
    robots are points on a graph; here they have a shape, so that one may ask several others to make way.
"""

from collections.abc import Sequence

from plr_jax.planners.lacam.moves import Bits, Moves

_MOST_CHOICES = 20  # tried a robot, before nobody is asked to make way any more


class PIBT:
    """A step of the team that is being found: what robots have chosen, and what they may still choose."""

    def __init__(self, moves: Moves):
        self.moves = moves
        self.chosen = [-1] * len(moves.ranked)
        self.allowed: list[Bits] = [-1] * len(moves.ranked)
        self.num_left = _MOST_CHOICES * len(moves.ranked)
        self._robots: list[int] = []  # in the order in which they chose
        self._changes: list[tuple[int, Bits]] = []  # to what is allowed: whom it was, and what it was

    def find(self, order: Sequence[int], constraints: Sequence[tuple[int, int]]) -> list[int] | None:
        """The primitives of all robots; None if none were found under the constraints.

        Args:
            order: The robots, those of the highest priority first.
            constraints: Robots, and the primitives that they must choose.
        """
        for robot, primitive in constraints:
            if not self.allowed[robot] >> primitive & 1:
                return None
            self._choose(robot, primitive)
        for robot, _ in constraints:
            if not self._make_way(robot):
                return None
        for robot in order:
            if self.chosen[robot] < 0 and not self._decide(robot):
                return None
        return self.chosen

    def _decide(self, robot: int) -> bool:
        """Choose the best primitive for which others make way; whether there is one."""
        for primitive in self.moves.ranked[robot]:
            if self.allowed[robot] >> primitive & 1:
                self.num_left -= 1
                num_chosen, num_changes = len(self._robots), len(self._changes)
                self._choose(robot, primitive)
                if self._make_way(robot):
                    return True
                self._undo(num_chosen, num_changes)
        return False

    def _choose(self, robot: int, primitive: int) -> None:
        """Choose a primitive: others may no longer choose what collides with it."""
        self.chosen[robot] = primitive
        self._robots.append(robot)
        for other, collide in self.moves.neighbors[robot]:
            if self.chosen[other] < 0 and self.allowed[other] & collide[primitive]:
                self._changes.append((other, self.allowed[other]))
                self.allowed[other] &= ~collide[primitive]

    def _make_way(self, robot: int) -> bool:
        """Let those choose that cannot stay beside a robot; whether all of them can."""
        for other, _ in self.moves.neighbors[robot]:
            in_the_way = self.chosen[other] < 0 and not self.allowed[other] & 1
            if in_the_way and (self.num_left < 0 or not self._decide(other)):
                return False
        return True

    def _undo(self, num_chosen: int, num_changes: int) -> None:
        """Take back choices, the last ones first, until so many are left."""
        while len(self._changes) > num_changes:
            robot, allowed = self._changes.pop()
            self.allowed[robot] = allowed
        while len(self._robots) > num_chosen:
            self.chosen[self._robots.pop()] = -1
