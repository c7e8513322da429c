"""One step of a whole team: priority inheritance with backtracking.

Robots choose in the order of their priorities. Each takes its best primitive that keeps clear of what others have
chosen, and of robots that have not chosen it asks no more than that they get out of the way: they choose next, and if
one cannot, the primitive is given up. So everybody who has not chosen can stay, and a step always exists.
"""

from collections.abc import Sequence

from plr_jax.planners.lacam.moves import Bits, Moves

_LARGEST_EFFORT = 20  # choices tried a robot, before robots only stay or move where nobody has to give way


class StepSearch:
    """The search for one step: what each robot has chosen, and may still choose."""

    def __init__(self, moves: Moves):
        self.moves = moves
        num_robots = len(moves.ranked)
        self.chosen = [-1] * num_robots
        self.allowed: list[Bits] = [-1] * num_robots
        self.trail: list[tuple[int, Bits]] = []
        self.order: list[int] = []
        self.effort = _LARGEST_EFFORT * num_robots

    def step(self, order: Sequence[int], constraints: Sequence[tuple[int, int]]) -> list[int] | None:
        """Primitives of all robots, of which some are given; None if no step was found.

        Args:
            order: The robots, those of the highest priority first.
            constraints: Robots and the primitives that they must choose.
        """
        for robot, primitive in constraints:
            if not (self.allowed[robot] >> primitive & 1 and self._choose(robot, primitive)):
                return None
        for robot, _ in constraints:
            if not self._make_way(robot):
                return None
        for robot in order:
            if self.chosen[robot] < 0 and not self._decide(robot):
                return None
        return self.chosen

    def _decide(self, robot: int) -> bool:
        """Choose the best primitive that can be had."""
        for primitive in self.moves.ranked[robot]:
            if not self.allowed[robot] >> primitive & 1:
                continue
            self.effort -= 1
            choices, changes = len(self.order), len(self.trail)
            if self._choose(robot, primitive) and self._make_way(robot):
                return True
            self._undo(choices, changes)
        return False

    def _choose(self, robot: int, primitive: int) -> bool:
        """Choose a primitive, and say whether it leaves some to each neighbor."""
        self.chosen[robot] = primitive
        self.order.append(robot)
        for other, collide in self.moves.neighbors[robot]:
            bits = collide[primitive]
            if bits and self.chosen[other] < 0:
                self.trail.append((other, self.allowed[other]))
                self.allowed[other] &= ~bits
        return True

    def _make_way(self, robot: int) -> bool:
        """Let the neighbors choose that cannot stay where they are."""
        for other, _ in self.moves.neighbors[robot]:
            if self.chosen[other] < 0 and not self.allowed[other] & 1:
                if self.effort < 0 or not self._decide(other):
                    return False
        return True

    def _undo(self, choices: int, changes: int) -> None:
        """Forget the choices since then."""
        while len(self.trail) > changes:
            robot, allowed = self.trail.pop()
            self.allowed[robot] = allowed
        while len(self.order) > choices:
            self.chosen[self.order.pop()] = -1
