"""Operations that write a program: values are its expressions, and those that have a name are its statements."""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partialmethod
from typing import Any

import numpy as np

from plr_jax._arrays import shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.portable.arithmetic import Operations, Program

_ATOM, _PRODUCT, _SUM, _COMPARISON, _CONDITION = range(5, 0, -1)  # how tightly each binds


@dataclass(frozen=True, eq=False)
class Expression:
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
    language: "Emitter"

    __array_ufunc__ = None  # NumPy's scalars leave operators to this class

    def __str__(self) -> str:
        return self.text

    def at_least(self, level: int) -> str:
        """The text, in parentheses if it binds less tightly."""
        return self.text if self.level >= level else f"({self.text})"

    def _joined(self, symbol: str, left: "Expression", right: "Expression", level: int) -> "Expression":
        of_type = "double" if "double" in (left.type, right.type) else "float"
        # Sums and products are from left to right.
        text = f"{left.at_least(level)} {symbol} {right.at_least(level + 1)}"
        value = Expression(text, level, of_type, self.language)
        return value if self.language.is_rounded or of_type == "double" else self.language.rounded(value)

    def __add__(self, other: Any) -> "Expression":
        return self._joined("+", self, self.language.constant(other), _SUM)

    def __radd__(self, other: Any) -> "Expression":
        return self._joined("+", self.language.constant(other), self, _SUM)

    def __sub__(self, other: Any) -> "Expression":
        if not isinstance(other, Expression) and other == 0:
            return self
        if not isinstance(other, Expression) and other < 0:
            return self + -other
        return self._joined("-", self, self.language.constant(other), _SUM)

    def __rsub__(self, other: Any) -> "Expression":
        return self._joined("-", self.language.constant(other), self, _SUM)

    def __mul__(self, other: Any) -> "Expression":
        if not isinstance(other, Expression) and other == 1:
            return self
        return self._joined("*", self, self.language.constant(other), _PRODUCT)

    def __rmul__(self, other: Any) -> "Expression":
        return self._joined("*", self.language.constant(other), self, _PRODUCT)

    def __neg__(self) -> "Expression":
        return Expression(f"-{self.at_least(_ATOM)}", _PRODUCT, self.type, self.language)

    def _compared(self, symbol: str, other: Any) -> "Expression":
        left, right = self.at_least(_SUM), self.language.constant(other).at_least(_SUM)
        return Expression(f"{left} {symbol} {right}", _COMPARISON, "int", self.language)

    __lt__, __gt__ = partialmethod(_compared, "<"), partialmethod(_compared, ">")
    __le__, __ge__ = partialmethod(_compared, "<="), partialmethod(_compared, ">=")

    def __and__(self, other: "Expression") -> "Expression":
        text = f"{self.at_least(_CONDITION)} {self.language.conjunction} {other.at_least(_CONDITION)}"
        return Expression(text, _CONDITION, "int", self.language)


class Emitter(Operations, ABC):
    """Operations that write statements, one a name.

    Attributes:
        conjunction: How both of two conditions are asked for.
        conditional: An expression of a condition and two values.
        root_of: The root of a 32-bit float, in 32 bits: that of 64 bits, rounded, is the same.
        cast: A value in 32 bits.
        definition: The statement that gives a value of some type its name.
        is_rounded: Whether what an operation gives is in the precision of its type as it is.
    """

    conjunction, conditional = "&&", "({} ? {} : {})"
    root_of: str
    cast: str
    definition: str
    is_rounded = True

    def __init__(self) -> None:
        self.statements: list[str] = []
        self._names: Counter[str] = Counter()

    def atom(self, text: str, of_type: str = "float") -> Expression:
        """An expression that needs no parentheses."""
        return Expression(text, _ATOM, of_type, self)

    def constant(self, value: Any) -> Expression:
        """A number as it stands in the program; a text as it is."""
        if isinstance(value, Expression):
            return value
        number = value if isinstance(value, np.floating) else np.float32(value)
        of_type = "double" if isinstance(number, np.float64) else "float"
        return Expression(self.literal(number), _ATOM if number >= 0 else _PRODUCT, of_type, self)

    def let(self, name: str, value: Any) -> Expression:
        """A new name, numbered, for an expression; a name stays what it is."""
        if value.text.isidentifier():
            return value
        unique = f"{name}_{self._names[name]}"
        self._names[name] += 1
        self.statements.append(self.definition.format(type=value.type, name=unique, value=value))
        return self.atom(unique, value.type)

    def where(self, condition: Expression, yes: Any, no: Any) -> Expression:
        """One of two values."""
        yes, no = self.constant(yes), self.constant(no)
        return self.atom(self.conditional.format(condition, yes, no), no.type)

    def root(self, x: Expression) -> Expression:
        """The square root of a 32-bit number."""
        return self.atom(self.root_of.format(x))

    def rounded(self, x: Expression) -> Expression:
        """The value in 32 bits."""
        return self.atom(self.cast.format(x))

    @abstractmethod
    def literal(self, number: np.floating) -> str:
        """A number."""

    @abstractmethod
    def floor(self, x: Expression) -> Expression:
        """The largest integer that is not above, in the same type."""

    @abstractmethod
    def fraction(self, x: Expression) -> Expression:
        """The 23 bits behind the point: in Python as they are, elsewhere at the upper end of a word."""

    def used_statements(self) -> list[str]:
        """All statements of C or JavaScript but constants that no later one reads."""
        kept: list[str] = []
        for statement in reversed(self.statements):
            name = re.match(r"const (?:\w+ )?(\w+) = ", statement)
            if name is None or re.search(rf"\b{name[1]}\b", " ".join(kept)):
                kept.append(statement)
        return kept[::-1]


def write_lookup(
    do: Emitter,
    program: Program,
    of_type: str,
    read_leaf: Callable[[Any, list[Expression]], list[Expression]],
    outside: list[str],
) -> tuple[list[Expression], list[Expression]]:
    """Write a function of C or JavaScript, of a point ``x``, as far as its leaf.

    Args:
        do: What writes it.
        program: What it computes.
        of_type: Of the coordinates that are given, ``float`` or ``double``.
        read_leaf: Writes by ``do`` how the leaf at fractions along each axis is found, and returns its numbers.
        outside: Statements for points outside the domain.

    Returns:
        How far the placed point is above the domain's lower corner, and the leaf's numbers.
    """
    x = [do.atom(f"x[{axis}]", of_type) for axis in range(program.dim)]
    if of_type == "double":
        x = program.wrap_in_double(do, x)
        x = [do.let("x", do.rounded(along)) for along in x] if program.corner is None else x
    do.statements += [f"if (!({program.contains(do, x)})) {{", *indent(outside), "}"]
    offsets = program.offsets(do, program.fold_and_wrap(do, program.relative(do, x)))
    return offsets, read_leaf(do, program.fractions(do, offsets))


def nan_condition(dim: int) -> str:
    """The condition of C and JavaScript that a coordinate of ``x`` is NaN."""
    return " || ".join(f"x[{axis}] != x[{axis}]" for axis in range(dim))


def require_identifier(name: object) -> None:
    """``ValueError`` unless definitions of C may begin with it."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ValueError(f"The name must be an identifier of C, such as plr_maze, got {shortened(name)}.")


def format_domain(domain: Box) -> str:
    """A domain as readers of code know it."""
    return " x ".join(
        f"[{lo}, {hi}{')' if is_periodic else ']'}{' periodic' if is_periodic else ''}"
        for lo, hi, is_periodic in zip(domain.lo.tolist(), domain.hi.tolist(), domain.periodic, strict=True)
    )


_WIDTH = 100  # of a line


def indent(lines: Iterable[str]) -> list[str]:
    """Lines farther right."""
    return [f"    {line}" for line in lines]


def wrap_entries(entries: Iterable[str]) -> list[str]:
    """Entries, separated by commas, in lines that are full."""
    lines, line = [], ""
    for entry in entries:
        if len(line) + len(entry) > _WIDTH:
            lines.append(line)
            line = ""
        line += f"{' ' if line else '    '}{entry},"
    return [*lines, line]
