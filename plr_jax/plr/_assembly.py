"""PLRs put together: from the bytes of a file, or from leaves, for which its file is written."""

from dataclasses import replace
from functools import partial
from typing import Any

from plr_jax._arrays import shortened
from plr_jax.plr._file import Contents, decode, encode
from plr_jax.plr._plr import PLR, assembled
from plr_jax.plr.certificate.certificate import Certificate
from plr_jax.plr.file.held import held


def from_bytes(data: bytes) -> PLR:
    """The PLR that a file's bytes hold.

    Args:
        data: What :meth:`PLR.to_bytes` gave.

    Returns:
        The PLR, which answers as the one that was written, bit for bit.

    Raises:
        ValueError: If the bytes are not those of a PLR file of a version this release reads, its distances are
            beyond 32-bit floats, or reading it would take far more than a file of its size ought to.
    """
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ValueError(f"data must be the bytes of a PLR file, got {shortened(data)}.")
    data = bytes(data)
    return assembled(data, decode(data))


def deferred_plr(data: bytes) -> PLR:
    """The PLR that a file's bytes hold, which are known to be right: its tables are made when they are first used."""
    plr = object.__new__(PLR)
    vars(plr).update(file=held(data), _deferred=partial(from_bytes, data))
    return plr


def plr_of_leaves(contents: Contents) -> PLR:
    """The PLR of these leaves: the one that its file gives, bit for bit, without reading it."""
    return assembled(encode(contents), contents)


def with_stored(plr: PLR, stored: Any) -> PLR:
    """A PLR of the same partition and model that stores something else, of which nothing is proven."""
    return plr_of_leaves(replace(plr._contents, stored=stored, certificate=None)).with_label(plr.label)


def with_certificate(plr: PLR, certificate: Certificate) -> PLR:
    """The same PLR with another proof."""
    return plr_of_leaves(replace(plr._contents, certificate=certificate)).with_label(plr.label)
