"""PLRs from web servers: as much of a file as is wanted, by HTTP ranges.

Any server of static files will do. One that knows no ranges is not read farther than is wanted.
"""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from plr_jax._arrays import as_finite_point, as_number, require_integer, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph
from plr_jax.pairs import PairPLR
from plr_jax.pairs.pair_plr import pairs_from_bytes
from plr_jax.pairs.stored import Stored
from plr_jax.plr import PLR, construct, from_bytes
from plr_jax.plr.file.container import MOST_BYTES, PAIRS_CODE, Header
from plr_jax.remote.ranges import Fetched, fetch

_FIRST_BYTES = 4096
"""What is asked for first where it has to be seen how much to ask for: the header, and of small maps all."""
_TIMES = 3
"""Bytes of the PLR of one goal for each of the outline: corners take a few, and cones name them."""


def open_url(
    url: str, max_bytes: int | None = None, *, goal: ArrayLike | None = None, timeout: float = 10.0
) -> PLR | PairPLR:
    """The PLR or PairPLR in a file on a web server, or the finest one that its first bytes hold.

    A file made by :func:`progressive` is one of a coarser PLR, with its proof, wherever it is cut off at one of its
    marks. With ``max_bytes`` only so many bytes are fetched, in one request. Of a PairPLR the first part, the outline
    of free space, is enough to answer, if slower; with a ``goal`` only that is fetched, and compressed into a PLR of
    the distance to the goal, which takes as long as :class:`VisibilityGraph` and :func:`construct` do for so many
    corners.

    Args:
        url: An address that begins with ``http://`` or ``https://``, without a user's name and password.
        max_bytes: How many bytes of the file to fetch at the most; None: all, up to 256 MiB.
        goal: For a file of pairs: the one goal wanted, ``(2,)``; the result is a PLR. None: none.
        timeout: Seconds after which to give up on a request.

    Returns:
        A PLR; or a PairPLR, if the file is one and no goal is given. Nothing is proven of a PLR to a goal.

    Raises:
        OSError: If the server cannot be reached, answers with an error, breaks off or takes too long; or if all
            is asked for and there is more than is read: 256 MiB, or 32 MiB if the server does not say how much.
        ValueError: If an argument is out of its range; what is sent is corrupt, is no such file, changed between two
            requests, or has no mark within ``max_bytes``; or nothing reaches the goal.
    """
    if not isinstance(url, str) or not url.isascii() or not url.startswith(("http://", "https://")):
        got = shortened(_without_secrets(url) if isinstance(url, str) else url)
        raise ValueError(
            f"url must begin with http:// or https:// and be of ASCII, others as %XX, got {got}; use load for a file."
        )
    if (shown := _without_secrets(url)) != url:
        raise ValueError(f"url must have no user name and password, which are not sent, got {shortened(shown)}.")
    if max_bytes is not None:
        require_integer("max_bytes", max_bytes, 1)
    limit = threading.TIMEOUT_MAX
    timeout = as_number("timeout", timeout, f"seconds from 0 to {limit:g}", lambda seconds: 0 < seconds <= limit)
    most = MOST_BYTES if max_bytes is None else min(int(max_bytes), MOST_BYTES)
    if goal is not None:
        goal = as_finite_point("The goal", goal, 2)
        return _to_goal(*_outline(url, most, timeout), goal)
    fetched = fetch(url, most, timeout)
    while max_bytes is None and not fetched.is_complete:  # a server may send less than what it was asked for
        known = len(fetched.data)
        if known < min(most, fetched.size or 0):
            fetched = fetch(url, most, timeout, fetched)
        if len(fetched.data) == known:
            raise OSError(
                f"{url} has more than the {known:,} bytes that were sent: give max_bytes for the first ones."
            )
    with _named(url):
        header = Header.read(fetched.data)
        data = fetched.data[: _cut(fetched, header, max_bytes)]
        return (pairs_from_bytes if header.leaf_code == PAIRS_CODE else from_bytes)(data)


def _without_secrets(url: str) -> str:
    """An address as errors may show it: without a user's name and password."""
    return re.sub(r"^([a-zA-Z]*:?//)?[^/?#]*@", r"\1***@", url)


@contextmanager
def _named(url: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{url} cannot be read as a PLR: {error}.") from error


def _cut(fetched: Fetched, header: Header, max_bytes: int | None) -> int:
    """Where to cut what was fetched: nowhere if it is all, else at the last mark in it."""
    size = len(fetched.data)
    if max_bytes is None and fetched.has_ended and header.marks and header.marks[-1] >= size:
        raise ValueError(f"it goes on to beyond {header.marks[-1]:,} bytes, of which the server sent {size:,}")
    if fetched.is_complete:
        return size
    marks = [mark for mark in header.marks if mark <= size]
    if not marks:
        of_file = "more" if fetched.size is None else f"{fetched.size:,}"
        least = f", and its first mark is at {header.marks[0]:,}" if header.marks else " and no marks"
        sent = f"got {max_bytes}, of which {size:,} were sent"
        raise ValueError(f"it has {of_file} bytes{least}: give a larger max_bytes, {sent}")
    return marks[-1]


def _outline(url: str, most: int, timeout: float) -> tuple[Workspace, int]:
    """The workspace that the first part of a file of pairs holds the outline of, and its bytes."""
    fetched = fetch(url, min(most, _FIRST_BYTES), timeout)
    with _named(url):
        header = Header.read(fetched.data)
        if header.leaf_code != PAIRS_CODE or not header.marks:
            raise ValueError("it holds no distances of pairs, of which a goal is one point")
        if (mark := header.marks[0]) > most:
            raise ValueError(f"what a goal needs are its first {mark:,} bytes, more than max_bytes={most:,}")
    while mark > (known := len(fetched.data)):
        fetched = fetch(url, mark, timeout, fetched)
        if len(fetched.data) == known:
            raise OSError(f"{url} broke off after {known:,} of {mark:,} bytes.")
    with _named(url):
        return Stored.from_bytes(fetched.data[:mark]).workspace, mark


def _to_goal(workspace: Workspace, num_bytes: int, goal: ArrayLike) -> PLR:
    """The distance to a goal in a workspace, in a file of a few times what was fetched of its outline."""
    exact = VisibilityGraph(workspace, goal)
    return construct(exact, workspace.bounds, leaf="cone", max_bytes=max(_TIMES * num_bytes, _FIRST_BYTES))
