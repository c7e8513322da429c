"""Configuration spaces that count what they are asked: the price of a method in tests of freedom."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int8

from plr_jax import Box, ConfigurationSpace, MotionCost, SeesBoxes

Configurations = Float[np.ndarray, "n dof"]


@dataclass
class Tests:
    """How often a space was asked, and about how many configurations, motions and boxes."""

    calls: int = 0
    configurations: int = 0
    motions: int = 0
    boxes: int = 0

    def add(self, kind: str, asked: np.ndarray) -> None:
        """One call more."""
        self.calls += 1
        setattr(self, kind, getattr(self, kind) + len(asked))

    def for_json(self) -> dict[str, int]:
        return asdict(self)


@dataclass(frozen=True, eq=False)
class CountedSpace:
    """A configuration space, and how often it was asked."""

    space: ConfigurationSpace
    tests: Tests = field(default_factory=Tests)

    @property
    def domain(self) -> Box:
        return self.space.domain

    @property
    def motion_cost(self) -> MotionCost:
        return self.space.motion_cost

    def is_free(self, q: Any) -> Bool[np.ndarray, "n"]:
        self.tests.add("configurations", q)
        return self.space.is_free(q)

    def are_free(self, q0: Any, q1: Any) -> Bool[np.ndarray, "n"]:
        self.tests.add("motions", q0)
        return self.space.are_free(q0, q1)

    def classify(self, lo: Any, hi: Any) -> Int8[np.ndarray, "n"]:
        self.tests.add("boxes", lo)
        return self.space.classify(lo, hi)


@dataclass(frozen=True, eq=False)
class CountedSeeingSpace(CountedSpace):
    """The same of a space that sees boxes: each box that is looked into counts as one more."""

    def sees_boxes(self, q: Any, lo: Any, hi: Any) -> Bool[np.ndarray, "n"]:
        assert isinstance(self.space, SeesBoxes)
        self.tests.add("boxes", lo)
        return self.space.sees_boxes(q, lo, hi)


def counted(space: ConfigurationSpace) -> CountedSpace:
    """The space with everything that it can do, none of it asked yet."""
    return CountedSeeingSpace(space) if isinstance(space, SeesBoxes) else CountedSpace(space)
