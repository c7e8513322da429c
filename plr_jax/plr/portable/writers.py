"""Operations that write a program: values are its expressions, and those that have a name are its statements."""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.leaves.base import SourcedLeafModel
from plr_jax.plr.portable.arithmetic import Program, distinct_rows

_ATOM, _PRODUCT, _SUM, _COMPARISON, _CONDITION = range(5, 0, -1)  # how tightly each binds


@dataclass(frozen=True, eq=False)
class Text:
    """An expression. Operators join texts as they join numbers, with the parentheses that the order needs.

    Attributes:
        text: As it stands in the program.
        level: How tightly its outermost operator binds.
        type: What it is: ``float``, ``double``, ``int`` of conditions, or ``uint32_t``.
        language: That of the program.
    """

    text: str
    level: int
    type: str
    language: "Writer"

    __array_ufunc__ = None  # NumPy's scalars leave operators to this class

    def __str__(self) -> str:
        return self.text

    def at_least(self, level: int) -> str:
        """The text, in parentheses if it binds less tightly."""
        return self.text if self.level >= level else f"({self.text})"

    def _joined(self, symbol: str, left: "Text", right: "Text", level: int) -> "Text":
        of_type = "double" if "double" in (left.type, right.type) else "float"
        # Sums and products are from left to right.
        text = f"{left.at_least(level)} {symbol} {right.at_least(level + 1)}"
        return self.language.rounded_to_type(Text(text, level, of_type, self.language))

    def __add__(self, other: Any) -> "Text":
        return self._joined("+", self, self.language.constant(other), _SUM)

    def __radd__(self, other: Any) -> "Text":
        return self._joined("+", self.language.constant(other), self, _SUM)

    def __sub__(self, other: Any) -> "Text":
        if not isinstance(other, Text) and other == 0:
            return self
        if not isinstance(other, Text) and other < 0:
            return self + -other
        return self._joined("-", self, self.language.constant(other), _SUM)

    def __rsub__(self, other: Any) -> "Text":
        return self._joined("-", self.language.constant(other), self, _SUM)

    def __mul__(self, other: Any) -> "Text":
        if not isinstance(other, Text) and other == 1:
            return self
        return self._joined("*", self, self.language.constant(other), _PRODUCT)

    def __rmul__(self, other: Any) -> "Text":
        return self._joined("*", self.language.constant(other), self, _PRODUCT)

    def __neg__(self) -> "Text":
        return Text(f"-{self.at_least(_ATOM)}", _PRODUCT, self.type, self.language)

    def _compared(self, symbol: str, other: Any) -> "Text":
        left, right = self.at_least(_SUM), self.language.constant(other).at_least(_SUM)
        return Text(f"{left} {symbol} {right}", _COMPARISON, "int", self.language)

    def __lt__(self, other: Any) -> "Text":
        return self._compared("<", other)

    def __gt__(self, other: Any) -> "Text":
        return self._compared(">", other)

    def __le__(self, other: Any) -> "Text":
        return self._compared("<=", other)

    def __ge__(self, other: Any) -> "Text":
        return self._compared(">=", other)

    def __and__(self, other: "Text") -> "Text":
        text = f"{self.at_least(_CONDITION)} {self.language.conjunction} {other.at_least(_CONDITION)}"
        return Text(text, _CONDITION, "int", self.language)


class Writer(ABC):
    """Operations that write statements, one a name.

    Attributes:
        conjunction: How both of two conditions are asked for.
        conditional: An expression of a condition and two values.
        root_of: The root of a 32-bit float, in 32 bits: that of 64 bits, rounded, is the same.
        cast: A value in 32 bits.
    """

    conjunction: str
    conditional: str
    root_of: str
    cast: str

    def __init__(self) -> None:
        self.statements: list[str] = []
        self._names: Counter[str] = Counter()

    def atom(self, text: str, of_type: str = "float") -> Text:
        """An expression that needs no parentheses."""
        return Text(text, _ATOM, of_type, self)

    def constant(self, value: Any) -> Text:
        """A number as it stands in the program; a text as it is."""
        if isinstance(value, Text):
            return value
        number = value if isinstance(value, np.floating) else np.float32(value)
        of_type = "double" if isinstance(number, np.float64) else "float"
        return Text(self.literal(number), _ATOM if number >= 0 else _PRODUCT, of_type, self)

    def let(self, name: str, value: Any) -> Text:
        """A new name, numbered, for an expression; a name stays what it is."""
        if value.text.isidentifier():
            return value
        unique = f"{name}_{self._names[name]}"
        self._names[name] += 1
        self.statements.append(self.definition(unique, value))
        return self.atom(unique, value.type)

    def rounded_to_type(self, value: Text) -> Text:
        """What an operation gives, in the precision of its type: in most languages as it is."""
        return value

    def where(self, condition: Text, yes: Any, no: Any) -> Text:
        """One of two values."""
        yes, no = self.constant(yes), self.constant(no)
        return self.atom(self.conditional.format(condition, yes, no), no.type)

    def root(self, x: Text) -> Text:
        """The square root of a 32-bit number."""
        return self.atom(self.root_of.format(x))

    def rounded(self, x: Text) -> Text:
        """The value in 32 bits."""
        return self.atom(self.cast.format(x))

    @abstractmethod
    def literal(self, number: np.floating) -> str:
        """A number."""

    @abstractmethod
    def definition(self, name: str, value: Text) -> str:
        """The statement that gives a value its name."""

    @abstractmethod
    def floor(self, x: Text) -> Text:
        """The largest integer that is not above, in the same type."""

    @abstractmethod
    def fraction(self, x: Text) -> Text:
        """The 23 bits behind the point: in Python as they are, elsewhere at the upper end of a word."""


class BracedWriter(Writer):
    """Of C and JavaScript, as far as these are spelled alike."""

    conjunction, conditional = "&&", "({} ? {} : {})"

    def used_statements(self) -> list[str]:
        """All statements but constants that no later one reads."""
        kept: list[str] = []
        for statement in reversed(self.statements):
            name = re.match(r"const (?:\w+ )?(\w+) = ", statement)
            if name is None or re.search(rf"\b{name[1]}\b", " ".join(kept)):
                kept.append(statement)
        return kept[::-1]


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
