"""What answers from tables and holds the file that they were made of."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, cast

import jax
import numpy as np

from plr_jax._arrays import padded, padded_size
from plr_jax.plr.file.container import Container, Header, require_label

if TYPE_CHECKING:
    from jaxtyping import Array, UInt8

Held = TypeVar("Held", bound="HeldFile")
_SIZE_BYTES = 4


class HeldFile:
    """Its bytes, and how much memory the tables take."""

    if TYPE_CHECKING:
        tables: Any
        file: UInt8[Array, "padded"] | UInt8[np.ndarray, "padded"]

    def to_bytes(self) -> bytes:
        """The bytes of the file, which :func:`save` writes; ``ValueError`` where the arrays are those of several."""
        if np.ndim(self.file) != 1:
            raise ValueError(f"Bytes are those of one, but these arrays are those of several: {self.file.shape}.")
        return np.asarray(self.file).tobytes()[: self.num_bytes]

    @property
    def num_bytes(self) -> int:
        """Bytes of the file."""
        return int.from_bytes(np.asarray(self.file)[-_SIZE_BYTES:].tobytes(), "little")

    @property
    def file_marks(self) -> tuple[int, ...]:
        """Where a file of pairs may be cut off, in bytes from its start, to be one of the same pairs; none of a PLR.

        Of a file that was cut off at a mark, those before it.
        """
        return tuple(mark for mark in Header.read(self.to_bytes()).marks if mark < self.num_bytes)

    @property
    def label(self) -> str:
        """What the file says of itself: which map, which goal. Empty if it says nothing.

        Any text that who wrote the file chose; it may hold control characters, which a terminal obeys.
        """
        return Header.read(self.to_bytes()).label

    def with_label(self: Held, label: str) -> Held:
        """The same with another label.

        Args:
            label: Any text of up to 1,000 bytes in UTF-8, which the file then takes more.

        Returns:
            What answers alike, bit for bit.

        Raises:
            ValueError: If it is no text, or longer.
        """
        require_label(label)
        if label == self.label:
            return self
        data = replace(Container.from_bytes(self.to_bytes()), label=label).to_bytes()
        labeled = replace(cast(Any, self), file=held(data))
        vars(labeled).update({name: each for name, each in vars(self).items() if name == "_origin"})
        return labeled

    @property
    def resident_bytes(self) -> int:
        """Bytes of the tables that a query reads."""
        return sum(array.nbytes for array in jax.tree_util.tree_leaves(self.tables))


def held(data: bytes) -> "UInt8[np.ndarray, 'padded']":
    """Bytes of a file as an array of one of few sizes: padded with zeros, and last of all how many they are."""
    file = padded(np.frombuffer(data, np.uint8), padded_size(len(data) + _SIZE_BYTES))
    file[-_SIZE_BYTES:] = np.frombuffer(len(data).to_bytes(_SIZE_BYTES, "little"), np.uint8)
    return file
