"""What the functions of a program consist of, in any language: which steps, in which order."""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.leaves.base import SourcedLeafModel
from plr_jax.plr.portable.program import Program, distinct_rows
from plr_jax.plr.portable.text import BracedWriter, Text

_WIDTH = 100  # of a line
W = TypeVar("W", bound=BracedWriter)


class Code(ABC, Generic[W]):
    """The functions of a program in a language, which says how leaves are found and read.

    Attributes:
        type: Of the coordinates that are given, ``float`` or ``double``.
        rows: The different numbers that leaves have.
        tree: The tree, whose leaves are rows of them.
        is_sourced: Whether there are waypoints.
    """

    def __init__(self, program: Program, of_type: str, numbers: Float[np.ndarray, "leaves count"]) -> None:
        self.program, self.type = program, of_type
        self.rows, row_of_leaf = distinct_rows(numbers)
        self.tree = program.coded_tree(row_of_leaf)
        self.is_sourced = isinstance(program.leaf, SourcedLeafModel)

    @property
    def has_tree(self) -> bool:
        """Whether there is more than one leaf."""
        return len(self.tree.children) > 0

    @abstractmethod
    def writer(self) -> W:
        """Operations that write a function."""

    @abstractmethod
    def read_leaf(self, do: W, places: list[Text]) -> list[Text]:
        """The numbers of the leaf at places along each axis."""

    @abstractmethod
    def cells(self, do: W) -> list[tuple[Text, Text]]:
        """Along each axis, how many cells like that of the leaf last read there are, and which it is."""

    def distance(self, nan: str, infinity: str) -> tuple[W, Text]:
        """A function as far as its value, given what it answers for NaN, and else outside."""
        do, program = self.writer(), self.program
        given = self._given(do)
        is_nan = " || ".join(f"{along} != {along}" for along in map(str, given))
        x, above, numbers = self._found(do, given, [f"return {is_nan} ? {nan} : {infinity};"])
        cells = self.cells(do) if program.leaf.is_of_cells else []
        return do, program.value(do, x, above, numbers, cells)

    def waypoint(self, outside: list[str]) -> tuple[W, list[Text]]:
        """A function as far as the waypoint, given its statements outside."""
        do = self.writer()
        *_, numbers = self._found(do, self._given(do), outside)
        return do, self.program.waypoint(numbers)

    def _given(self, do: W) -> list[Text]:
        return [do.atom(f"x[{axis}]", self.type) for axis in range(self.program.dim)]

    def _found(self, do: W, given: list[Text], outside: list[str]) -> tuple[list[Text], list[Text], list[Text]]:
        """A placed point, how far it is above the lower corner, and its leaf's numbers."""
        program, x = self.program, given
        if self.type == "double":
            x = program.wrapped_wide(do, x)
            x = [do.let("x", do.rounded(along)) for along in x] if program.corner is None else x
        do.statements += [f"if (!({program.contains(do, x)})) {{", *indented(outside), "}"]
        x = program.placed(do, program.counted(do, x))
        above = program.above(do, x)
        return x, above, self.read_leaf(do, program.places(do, above))


def require_identifier(name: object) -> None:
    """``ValueError`` unless definitions of C may begin with it."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ValueError(f"The name must be an identifier of C, such as plr_maze, got {shortened(name)}.")


def ends_of(domain: Box) -> str:
    """A domain as readers of code know it."""
    return " x ".join(
        f"[{lo}, {hi}{')' if is_periodic else ']'}{' periodic' if is_periodic else ''}"
        for lo, hi, is_periodic in zip(domain.lo.tolist(), domain.hi.tolist(), domain.periodic, strict=True)
    )


def indented(lines: Iterable[str]) -> list[str]:
    """Lines farther right."""
    return [f"    {line}" for line in lines]


def filled_lines(entries: Iterable[str]) -> list[str]:
    """Entries, separated by commas, in lines that are full."""
    lines, line = [], ""
    for entry in entries:
        if len(line) + len(entry) > _WIDTH:
            lines.append(line)
            line = ""
        line += f"{' ' if line else '    '}{entry},"
    return [*lines, line]
