"""Files that are PLRs wherever they are cut off at a mark."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from plr_jax._arrays import shortened
from plr_jax.plr._plr import PLR
from plr_jax.plr.file.container import MOST_LAYERS
from plr_jax.plr.file.folding import folding_to_bytes
from plr_jax.plr.file.held import held


def progressive(plrs: Sequence[PLR]) -> PLR:
    """The last of some PLRs, in a file that begins with the others, the coarsest one first.

    Its first bytes, up to a mark, are a file of the first PLR, with its proof; those up to the next mark are one of
    the second, and so on. So who fetches the file has a distance function early (see :func:`open_url`), and need not
    fetch the rest. Each PLR is complete in itself: of sizes in steps of eight, all of them together take a seventh
    more than the last.

    Args:
        plrs: PLRs of one domain, at least one and at most 33, each with more bytes than the one before. They may
            differ in all else: their leaf models, their proofs.

    Returns:
        A PLR that answers as the last one, and has its proof and its label. ``file_marks`` says where its file may be
        cut off; ``num_bytes`` are those of all of it.

    Raises:
        ValueError: If they are not such PLRs.
    """
    if not isinstance(plrs, Iterable):
        raise ValueError(f"plrs must be a list of PLRs, the coarsest one first, got {shortened(plrs)}.")
    plrs = list(plrs)
    for plr in plrs:
        if not isinstance(plr, PLR):
            raise ValueError(f"plrs must be PLRs, got {shortened(plr)}.")
    if not 0 < len(plrs) <= MOST_LAYERS + 1:
        raise ValueError(f"A file holds 1 to {MOST_LAYERS + 1} PLRs, got {len(plrs)}.")
    *coarser, last = plrs
    for plr in coarser:
        if plr.domain != last.domain or _folding_bytes(plr) != _folding_bytes(last):
            raise ValueError(
                f"The PLRs of a file have one domain, and fold points alike, got {plr.domain} and {last.domain}."
            )
    layers = tuple(plr.container.last for plr in plrs)
    sizes = [len(layer.body) for layer in layers]
    if (np.diff(sizes) <= 0).any():
        raise ValueError(f"Each PLR of a file must have more bytes than the one before, got {sizes} without headers.")
    return replace(last, file=held(replace(last.container, layers=layers).to_bytes()))


def _folding_bytes(plr: PLR) -> bytes:
    folding = plr.container.folding
    return b"" if folding is None else folding_to_bytes(folding)
