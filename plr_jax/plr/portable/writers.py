"""Emitters: operations for ``arithmetic.py`` that generate source code instead of computing results.

Values are expressions of the target language. :meth:`Emitter.let` appends a statement that names an expression. For
example, with ``do = CEmitter("f")`` and ``x = do.atom("x[0]")``, ``do.let("share", (x - 1) * 2)`` appends the
statement ``const float share_0 = (x[0] - 1.0f) * 2.0f;`` and returns the expression ``share_0``.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partialmethod
from typing import Any

import numpy as np

from plr_jax._arrays import shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.portable.arithmetic import Operations, Program

_ATOM, _PRODUCT, _SUM, _COMPARISON, _CONDITION = range(5, 0, -1)  # precedence of operators, from high to low
_WIDTH = 100  # width of a line of generated code


@dataclass(frozen=True, eq=False)
class Expression:
    """The source text of an expression in the target language.

    Operators join the texts of two expressions, with parentheses where precedence asks for them.
    """

    text: str
    level: int  # precedence of the outermost operator
    type: str  # float, double, uint32_t or, for conditions, int
    language: "Emitter"
    __array_ufunc__ = None  # NumPy's scalars leave operators to this class: their products call __rmul__

    def __str__(self) -> str:
        return self.text

    def at_least(self, level: int) -> str:
        """Return the text, in parentheses if the precedence of its outermost operator is lower than ``level``."""
        return self.text if self.level >= level else f"({self.text})"

    def _joined(self, symbol: str, level: int, other: Any, swaps: bool = False) -> "Expression":
        # `self symbol other`, or with swapped sides, rounded to 32 bits if the language does not do this.
        other = self.language.constant(other)
        left, right = (other, self) if swaps else (self, other)
        of_type = "double" if "double" in (left.type, right.type) else "float"
        # Operators of equal precedence associate to the left.
        text = f"{left.at_least(level)} {symbol} {right.at_least(level + 1)}"
        value = Expression(text, level, of_type, self.language)
        return value if self.language.is_rounded or of_type == "double" else self.language.rounded(value)

    __add__, __radd__ = partialmethod(_joined, "+", _SUM), partialmethod(_joined, "+", _SUM, swaps=True)
    __rmul__ = partialmethod(_joined, "*", _PRODUCT, swaps=True)

    def __sub__(self, other: Any) -> "Expression":
        if not isinstance(other, Expression) and other <= 0:
            return self + -other if other else self
        return self._joined("-", _SUM, other)

    def __mul__(self, other: Any) -> "Expression":
        if not isinstance(other, Expression) and other == 1:
            return self
        return self._joined("*", _PRODUCT, other)

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
    """A base class of code generators; the attributes of a subclass are templates for the code of its language."""

    # Templates: fields in braces are replaced by the text of expressions.
    conjunction = "&&"
    conditional = "({} ? {} : {})"  # condition, value if it holds, other value
    root_of: str  # square root of a float, rounded to 32 bits; a 64-bit root that is then rounded is the same
    cast: str  # rounding to 32 bits
    definition: str  # assignment of a ``value`` to a new variable ``name`` of a ``type``
    is_rounded = True  # whether 32-bit operations are rounded to 32 bits without a cast

    def __init__(self) -> None:
        self.statements: list[str] = []

    def atom(self, text: str, of_type: str = "float") -> Expression:
        """Return source text that never needs parentheses, such as a name or a call, as an expression."""
        return Expression(text, _ATOM, of_type, self)

    def constant(self, value: Any) -> Expression:
        """Return the literal of a number as an expression; return expressions unchanged."""
        if isinstance(value, Expression):
            return value
        number = value if isinstance(value, np.floating) else np.float32(value)
        of_type = "double" if isinstance(number, np.float64) else "float"
        return Expression(self.literal(number), _ATOM if number >= 0 else _PRODUCT, of_type, self)

    def let(self, name: str, value: Any) -> Expression:
        """Append a statement that assigns ``value`` to a new variable, and return the variable.

        The variable is called ``name`` with a number. If ``value`` is a variable already, return it unchanged.
        """
        if value.text.isidentifier():
            return value
        unique = f"{name}_{len(self.statements)}"
        self.statements.append(self.definition.format(type=value.type, name=unique, value=value))
        return self.atom(unique, value.type)

    def where(self, condition: Expression, yes: Any, no: Any) -> Expression:
        yes, no = self.constant(yes), self.constant(no)
        return self.atom(self.conditional.format(condition, yes, no), no.type)

    def root(self, x: Expression) -> Expression:
        return self.atom(self.root_of.format(x))

    def rounded(self, x: Expression) -> Expression:
        return self.atom(self.cast.format(x))

    @abstractmethod
    def literal(self, number: np.floating) -> str: ...

    def used_statements(self) -> list[str]:
        """Return the statements of C or JavaScript, without definitions of variables that nothing reads."""
        used: list[str] = []  # from the last statement to the first: a definition is needed by statements after it
        for statement in reversed(self.statements):
            name = re.match(r"const (?:\w+ )?(\w+) = ", statement)
            if name is None or re.search(rf"\b{name[1]}\b", " ".join(used)):
                used.append(statement)
        return used[::-1]

    def write_lookup(
        self, program: Program, of_type: str, read_leaf: Callable[..., list[Expression]], outside: list[str]
    ) -> tuple[list[Expression], list[Expression]]:
        """Append code that finds the leaf of the point ``x``, whose coordinates have the type ``of_type``.

        The statements ``outside`` run if ``x`` is outside the domain. ``read_leaf(self, fractions)`` appends code
        that finds the leaf from the point's position, and returns the expressions of the leaf's parameters.

        Return two lists of expressions: ``x`` minus the domain's lower corner, and the leaf's parameters.
        """
        x = [self.atom(f"x[{axis}]", of_type) for axis in range(program.dim)]
        if of_type == "double":
            x = program.wrap_in_double(self, x)
            x = [self.let("x", self.rounded(along)) for along in x] if program.corner is None else x
        self.statements += [f"if (!({program.contains(self, x)})) {{", *indent(outside), "}"]
        offsets = program.offsets(self, program.relative(self, x))
        return offsets, read_leaf(self, program.fractions(self, offsets))

    def nan_condition(self, dim: int) -> str:
        """Return the condition, in C or JavaScript, that a coordinate of the point ``x`` is NaN."""
        return " || ".join(f"x[{axis}] != x[{axis}]" for axis in range(dim))


def require_identifier(name: object) -> None:
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ValueError(f"name must be a C identifier, such as plr_maze, got {shortened(name)}.")


def format_domain(domain: Box) -> str:
    """Format a domain for a comment, such as ``[0.0, 1.0] x [0.0, 6.28) periodic``."""
    axes = zip(domain.lo.tolist(), domain.hi.tolist(), domain.periodic, strict=True)
    return " x ".join(f"[{lo}, {hi}{') periodic' if is_periodic else ']'}" for lo, hi, is_periodic in axes)


def indent(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def wrap_entries(entries: Iterable[str]) -> list[str]:
    """Return lines of limited width with the entries of a C or JavaScript array, each followed by a comma."""
    lines = [""]
    for entry in entries:
        if len(lines[-1]) + len(entry) > _WIDTH:
            lines.append("")
        lines[-1] += f"{' ' if lines[-1] else '    '}{entry},"
    return lines
