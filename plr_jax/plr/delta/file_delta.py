r"""The bytes of a delta, which make a file of another one.

    2s      magic, b"P\xd5"
    u8      version, 1, and 16 more if a whole file follows
    4s      the first bytes of the SHA-256 of the file before
    4s      those of the file after
    of a whole file its length, a :func:`varint`, and it, deflated, with the end of the file before as a dictionary
    of another one the number of its leaves, a :func:`varint`, and, coded as ``file/range_coder.py`` does:
      is the label another one, and which: its length in 10 bits, and its bytes
      sources, as the leaf model has it (see ``leaves/cone/changed_sources.py``)
      the proof (see ``changed_bounds.py``)
      the tree and its leaves (see ``changed_leaves.py``)

A whole file is one of leaves without sources, or of several layers, or of another domain or leaf model than the one
before, or that has so little in common with that one that it is the smaller.
"""

import hashlib
import zlib
from dataclasses import dataclass, replace

import numpy as np

from plr_jax._arrays import shortened
from plr_jax.plr._file import Contents, decode, encode
from plr_jax.plr.delta.changed_bounds import Bounds, coded_bounds
from plr_jax.plr.delta.changed_leaves import Counts, NamedLeaves, coded_leaves
from plr_jax.plr.file.container import MOST_BYTES, Container
from plr_jax.plr.file.domain import ByteReader, varint
from plr_jax.plr.file.range_coder import RARE, Coder, RangeDecoder, RangeEncoder
from plr_jax.plr.leaves.base import SourcedLeafModel, as_sourced
from plr_jax.plr.partition.cells import Cells, tree_of_levels

_MAGIC, _VERSION, _WHOLE = b"P\xd5", 1, 16
_DIGEST_BYTES, _WINDOW = 4, 2**15
_LABEL_BITS = 10
_LEAVES_A_BYTE = 64  # leaves more than before, for each byte: more than any delta has


@dataclass(frozen=True, eq=False)
class _File:
    """What a file of one layer holds."""

    contents: Contents
    label: str

    @classmethod
    def of(cls, data: bytes) -> "_File":
        """Of its bytes; raises ``ValueError`` saying what is wrong with them."""
        return cls(decode(data), Container.from_bytes(data).label)


def delta_of_files(before: bytes, after: bytes) -> bytes:
    """What makes one file of another; raises ``ValueError`` saying what is wrong with one of them."""
    old, new = _File.of(before), _File.of(after)
    digests = _digest(before) + _digest(after)
    deflate = zlib.compressobj(9, wbits=-zlib.MAX_WBITS, zdict=before[-_WINDOW:])
    whole = varint(len(after)) + deflate.compress(after) + deflate.flush()
    deltas = [_MAGIC + bytes([_VERSION | _WHOLE]) + digests + whole]
    if _are_alike(old.contents, new.contents):
        num_leaves, coder = len(new.contents.cells), RangeEncoder()
        found = _coded_file(coder, old, new, num_leaves)
        coded = coder.to_bytes()
        if found == after and num_leaves <= _most_leaves(old.contents, coded):
            deltas.append(_MAGIC + bytes([_VERSION]) + digests + varint(num_leaves) + coded)
    return min(deltas, key=len)


def patched_file(before: bytes, delta: bytes) -> bytes:
    """The file that a delta makes of the one that it is of.

    Raises:
        ValueError: If it is of another one, or no delta, or damaged.
    """
    if not isinstance(delta, bytes | bytearray | memoryview):
        raise ValueError(f"A delta is bytes, as plr.delta(old) gives them, got {shortened(delta)}.")
    try:
        return _patched(before, bytes(delta))
    except ValueError as error:
        raise ValueError(f"The delta cannot be used: {error}.") from error


def _patched(before: bytes, delta: bytes) -> bytes:
    reader = ByteReader(delta)
    if delta[: len(_MAGIC)] != _MAGIC:
        raise ValueError("it does not start like one")
    if len(delta) > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES:,} bytes")
    reader.take(len(_MAGIC))
    if (version := reader.byte()) not in (_VERSION, _VERSION | _WHOLE):
        raise ValueError(f"it has version {version & 15}, this release reads version {_VERSION}; update plr_jax")
    if reader.take(_DIGEST_BYTES) != _digest(before):
        raise ValueError("it is of another file than this one; make it of this one, or send the new file")
    digest, number = reader.take(_DIGEST_BYTES), reader.varint()
    coded = delta[reader.at :]
    found = _inflated(before, coded, number) if version & _WHOLE else _decoded(before, coded, number)
    if _digest(found) != digest:
        raise ValueError("it is damaged: what it makes is not the file that it was made for")
    return found


def _inflated(before: bytes, deflated: bytes, num_bytes: int) -> bytes:
    if num_bytes > MOST_BYTES:
        raise ValueError(f"it states a file of more than {MOST_BYTES:,} bytes")
    try:
        inflate = zlib.decompressobj(wbits=-zlib.MAX_WBITS, zdict=before[-_WINDOW:])
        return inflate.decompress(deflated, num_bytes + 1)  # 0 would be without a limit
    except zlib.error:
        raise ValueError("it is damaged: nothing is deflated so") from None


def _decoded(before: bytes, coded: bytes, num_leaves: int) -> bytes:
    old = _File.of(before)
    if not 0 < num_leaves <= _most_leaves(old.contents, coded):
        raise ValueError(f"it states {num_leaves:,} leaves, of which its bytes cannot tell")
    try:
        with np.errstate(all="ignore"):  # of coordinates that no file has
            return _coded_file(RangeDecoder(coded), old, None, num_leaves)
    except ValueError as error:
        raise ValueError(f"it is damaged: {error}") from error


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()[:_DIGEST_BYTES]


def _are_alike(old: Contents, new: Contents) -> bool:
    """Whether the leaves of one may be those of the other."""
    return isinstance(old.leaf, SourcedLeafModel) and old.leaf == new.leaf and old.domain == new.domain


def _most_leaves(old: Contents, coded: bytes) -> int:
    return len(old.cells) + _LEAVES_A_BYTE * len(coded)


def _coded_file(coder: Coder, old: _File, new: _File | None, num_leaves: int) -> bytes:
    """The bytes of a file of so many leaves, which is encoded if it is given, else decoded."""
    label = _coded_label(coder, old.label, None if new is None else new.label)
    before, after = old.contents, None if new is None else new.contents
    model, domain = as_sourced(before.leaf), before.domain
    stored, index = model.coded_sources(coder, domain, before.stored, after and after.stored)
    _, source = model.sources(before.stored)
    bounds_before = Bounds.of(before.certificate, len(source))
    bounds_after = after and Bounds.of(after.certificate, len(after.cells))
    moved = _moved_pairs(before.cells, bounds_before, after.cells, bounds_after) if after and bounds_after else {}
    bounds, pair = coded_bounds(coder, bounds_before, bounds_after, moved)
    leaves = NamedLeaves.of(before.levels, index[source], pair[bounds_before.of_leaf])
    named = None
    if after and bounds_after:
        named = NamedLeaves.of(after.levels, model.sources(after.stored)[1], bounds_after.of_leaf)
    num_sources = len(model.sources(stored)[0].parents)
    counts = Counts(domain.dim, num_sources, len(bounds.pairs), num_leaves)
    levels, source, pair = coded_leaves(coder, leaves, named, counts)
    cells, stored = tree_of_levels(levels, domain.dim).leaves, model.with_sources(stored, source)
    certificate = replace(bounds, of_leaf=pair).certificate
    found = encode(Contents(domain, model, levels, cells, stored, certificate))
    return replace(Container.from_bytes(found), label=label).to_bytes()


def _coded_label(coder: Coder, before: str, after: str | None) -> str:
    if not coder.bit("another label", None if after is None else int(after != before), RARE):
        return before
    data = None if after is None else list(after.encode())
    length = coder.number(None if data is None else len(data), _LABEL_BITS)
    return bytes(coder.number(None if data is None else data[place], 8) for place in range(length)).decode(
        errors="replace"
    )


def _moved_pairs(before: Cells, bounds: Bounds, after: Cells, bounds_after: Bounds) -> dict[int, int]:
    """Pairs of bounds, and that which most leaves have afterwards that have them before."""
    _, old, new = np.intersect1d(before.hashes(), after.hashes(), return_indices=True)
    number, of_pair = len(bounds_after.pairs), bounds.of_leaf[old]
    if not number:
        return {}
    pairs, count = np.unique(of_pair * number + bounds_after.of_leaf[new], return_counts=True)
    order = np.argsort(count, kind="stable")
    return dict(zip((pairs // number)[order].tolist(), (pairs % number)[order].tolist(), strict=True))
