"""What a file keeps of a folding, after the domain: floats little-endian.

f64     the center, one number an axis
u8      1 if folded coordinates run along axes of their own, else 0
f64     of such the axes, row by row
u8      number of mirrors
u8      for each mirror, then for the radial part, one number an axis: 1 if it is reversed, or is radial, else 0
"""

import numpy as np
from jaxtyping import Bool

from plr_jax.geometry.box import Box
from plr_jax.plr.file.fields import ByteReader
from plr_jax.plr.folding.folding import Folding

_ORTHOGONAL = 1e-9


def folding_to_bytes(folding: Folding) -> bytes:
    """What the file keeps."""
    marks = np.array([*folding.mirrors, folding.radial], np.uint8)
    axes = folding.axes.astype("<f8").tobytes() if folding.is_turned else b""
    return b"".join(
        [
            folding.center.astype("<f8").tobytes(),
            bytes([folding.is_turned]),
            axes,
            bytes([len(folding.mirrors)]),
            marks.tobytes(),
        ]
    )


def read_folding(reader: ByteReader, domain: Box) -> Folding:
    """The next folding; raises ``ValueError`` saying what is wrong with it."""
    dim = domain.dim
    center = np.frombuffer(reader.take(8 * dim), "<f8").astype(np.float64)
    axes = np.eye(dim)
    if _flags(reader.take(1))[0]:
        axes = np.frombuffer(reader.take(8 * dim * dim), "<f8").astype(np.float64).reshape(dim, dim)
    marks = _flags(reader.take(dim * (reader.byte() + 1))).reshape(-1, dim)
    mirrors = tuple(tuple(map(bool, row)) for row in marks[:-1])
    folding = Folding(domain, center, axes, mirrors, tuple(map(bool, marks[-1])))
    _check(folding)
    return folding


def _flags(data: bytes) -> Bool[np.ndarray, "n"]:
    numbers = np.frombuffer(data, np.uint8)
    if (numbers > 1).any():
        raise ValueError(f"its folding has a mark of {numbers.max()}, which is 0 or 1")
    return numbers == 1


def _check(folding: Folding) -> None:
    axes, periodic = folding.axes, np.array(folding.domain.periodic)
    if not (np.isfinite(folding.center).all() and np.isfinite(axes).all()):
        raise ValueError("its folding has numbers that are not finite")
    unit = np.eye(len(axes))
    if np.abs(axes).max() > 2 or np.abs(axes @ axes.T - unit).max() > _ORTHOGONAL or (axes != unit)[periodic].any():
        raise ValueError("the axes of its folding are not orthogonal, or turn a periodic one")
    if (np.array(folding.radial) & periodic).any():
        raise ValueError("its folding measures a length along a periodic axis")
    if not folding.mirrors and not any(folding.radial):
        raise ValueError("its folding folds nothing")
    if folding.cutting != folding.mirrors:
        raise ValueError("its folding has a mirror that does not cut the domain")
