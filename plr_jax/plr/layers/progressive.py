"""Files that are PLRs wherever they are cut off at a mark."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from plr_jax._arrays import shortened
from plr_jax.plr._plr import PLR
from plr_jax.plr.file.container import layered
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
    whole = layered([plr.container for plr in plrs])
    return replace(plrs[-1], file=held(whole.to_bytes()))
