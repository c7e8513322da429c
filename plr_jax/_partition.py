"""What a metric or a picture asks of a function that has leaves."""

from typing import Protocol, runtime_checkable

from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box


@runtime_checkable
class Partition(Protocol):
    """A function that is one piece in each of many boxes, such as a PLR."""

    @property
    def domain(self) -> Box: ...
    @property
    def leaf_boxes(self) -> tuple[ArrayLike, ArrayLike]: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...
