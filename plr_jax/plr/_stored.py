"""What both kinds of PLR have in common: a file, and tables that a query reads, derived from it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float, UInt8

from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr.file.container import HEADER_SIZE, file_size
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.tables import Tables


@dataclass(frozen=True, eq=False)
class StoredFunction(ABC):
    """A function over a partition of a box, with the bytes of its file.

    Attributes:
        tables: What a query reads, derived from ``file`` alone.
        file: The bytes of the file, padded with zeros to a power of two.
    """

    tables: Tables
    file: UInt8[Array, "padded"] | UInt8[np.ndarray, "padded"]

    @abstractmethod
    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Value at each point, ``(..., dim)``."""

    @property
    @abstractmethod
    def domain(self) -> Box:
        """The closed box that is covered."""

    @property
    @abstractmethod
    def cells(self) -> Cells:
        """The leaves' cells, in the order of the tree's left-to-right traversal."""

    def to_bytes(self) -> bytes:
        """The bytes of the file, which :func:`save` writes."""
        return np.asarray(self.file).tobytes()[: self.num_bytes]

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.tables.dim

    @property
    def num_leaves(self) -> int:
        """Number of leaves of the partition."""
        return len(self.cells)

    @property
    def depth(self) -> int:
        """Largest number of splits between the root and a leaf."""
        return int(self.cells.depth.sum(axis=1).max())

    @property
    def num_bytes(self) -> int:
        """Bytes of the file."""
        return file_size(np.asarray(self.file)[:HEADER_SIZE].tobytes())

    @property
    def resident_bytes(self) -> int:
        """Bytes of the tables that a query reads."""
        return sum(leaf.nbytes for leaf in jax.tree_util.tree_leaves(self.tables))

    @property
    def leaf_boxes(self) -> tuple[Float[np.ndarray, "leaves dim"], Float[np.ndarray, "leaves dim"]]:
        """Lower and upper corners of the leaves."""
        return self.cells.boxes(self.domain)


def as_padded_array(data: bytes) -> UInt8[np.ndarray, "padded"]:
    """A file's bytes padded with zeros to a power of two, so that functions of like size share compiled code."""
    padded = np.zeros(1 << (len(data) - 1).bit_length(), np.uint8)
    padded[: len(data)] = np.frombuffer(data, np.uint8)
    return padded
