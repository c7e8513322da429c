"""Operations that write a program: values are its expressions, and those that have a name are its statements."""

import re
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

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


class PythonWriter(Writer):
    """Of Python, where numbers are NumPy's scalars; ``constants`` are those that the program names."""

    conjunction, conditional = "and", "({1} if {0} else {2})"
    root_of, cast = "float32(sqrt({}))", "float32({})"

    def __init__(self) -> None:
        super().__init__()
        self.constants: dict[str, Any] = {}

    def literal(self, number: np.floating) -> str:
        """The name of a constant."""
        name = f"k{len(self.constants)}"
        self.constants[name] = number
        return name

    def definition(self, name: str, value: Text) -> str:
        """An assignment."""
        return f"{name} = {value}"

    def floor(self, x: Text) -> Text:
        """The floor as a scalar of the same type."""
        return self.atom(f"{'float64' if x.type == 'double' else 'float32'}(floor({x}))", x.type)

    def fraction(self, x: Text) -> Text:
        """The product is exact."""
        return self.atom(f"(int({x * np.float32(1 << 23)}) & {(1 << 23) - 1})", "uint32_t")


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
