"""PLRs from web servers: as much of a file as is wanted, by HTTP ranges.

Any server of static files will do. One that knows no ranges is not read farther than is wanted.
"""

from urllib.parse import urlsplit

from plr_jax._arrays import as_finite_point, as_number, require_integer, shortened
from plr_jax._types import ArrayLike
from plr_jax.oracles import VisibilityGraph
from plr_jax.plr import PLR, PairPLR, construct, from_bytes
from plr_jax.plr.file.container import MOST_BYTES, PAIRS_CODE, Header
from plr_jax.plr.pairs.pair_plr import pairs_from_bytes
from plr_jax.plr.pairs.stored import Stored
from plr_jax.remote.ranges import Fetched, fetch

_FIRST_BYTES = 4096
"""What is asked for first where it has to be seen how much to ask for: the header, and of small maps all."""


def open_url(
    url: str, max_bytes: int | None = None, *, goal: ArrayLike | None = None, timeout: float = 10.0
) -> PLR | PairPLR:
    """The PLR or PairPLR in a file on a web server, or the finest one that its first bytes hold.

    A file made by :func:`progressive` is one of a coarser PLR, with its proof, wherever it is cut off at one of its
    marks. With ``max_bytes`` only so many bytes are fetched, in one request. Of a PairPLR the first part is enough to
    answer, if slower; with a ``goal`` only that is fetched, and compressed into a PLR of the distance to the goal.

    Args:
        url: An address that begins with ``http://`` or ``https://``.
        max_bytes: How many bytes of the file to fetch at the most; None: all, up to 256 MiB.
        goal: For a file of pairs: the one goal wanted, ``(2,)``; the result is a PLR. None: none.
        timeout: Seconds after which to give up on a request.

    Returns:
        A PLR; or a PairPLR, if the file is one and no goal is given. Nothing is proven of a PLR to a goal.

    Raises:
        OSError: If the server cannot be reached, answers with an error, breaks off or takes too long.
        ValueError: If an argument is out of its range; what is sent is corrupt, is no such file, changed between two
            requests, or has no mark within ``max_bytes``; or nothing reaches the goal.
    """
    if not isinstance(url, str) or urlsplit(url).scheme not in ("http", "https"):
        raise ValueError(f"url must begin with http:// or https://, got {shortened(url)}; use load for a file.")
    if max_bytes is not None:
        require_integer("max_bytes", max_bytes, 1)
    timeout = as_number("timeout", timeout, "a positive number of seconds", lambda seconds: seconds > 0)
    most = MOST_BYTES if max_bytes is None else min(int(max_bytes), MOST_BYTES)
    goal = None if goal is None else as_finite_point("The goal", goal, 2)
    fetched = fetch(url, most if goal is None else min(most, _FIRST_BYTES), timeout)
    try:
        header = Header.read(fetched.data)
        if goal is not None:
            if header.leaf_code != PAIRS_CODE or not header.marks:
                raise ValueError("it holds no distances of pairs, of which a goal is one point")
            if (mark := header.marks[0]) > most:
                raise ValueError(f"what a goal needs are its first {mark:,} bytes, more than max_bytes={most:,}")
            if mark > len(fetched.data):
                fetched = fetch(url, mark, timeout, fetched)
            return _to_goal(Stored.from_bytes(fetched.data[:mark]), goal, mark)
        data = fetched.data[: _cut(fetched, header, most)]
        return (pairs_from_bytes if header.leaf_code == PAIRS_CODE else from_bytes)(data)
    except ValueError as error:
        raise ValueError(f"{url} cannot be read as a PLR: {error}.") from error


def _cut(fetched: Fetched, header: Header, most: int) -> int:
    """Where to cut what was fetched: nowhere if it is all, else at the last mark in it."""
    if fetched.is_complete:
        return len(fetched.data)
    marks = [mark for mark in header.marks if mark <= len(fetched.data)]
    if not marks:
        size = "more" if fetched.size is None else f"{fetched.size:,}"
        least = f", and its first mark is at {header.marks[0]:,}" if header.marks else " and no marks"
        raise ValueError(f"it has {size} bytes{least}: give a larger max_bytes, got {most:,}")
    return marks[-1]


def _to_goal(stored: Stored, goal: ArrayLike, num_bytes: int) -> PLR:
    """The distance to a goal in the workspace that pairs are of, in a file about as large as what was fetched."""
    workspace = stored.workspace
    exact = VisibilityGraph(workspace, goal)
    return construct(exact, workspace.bounds, leaf="cone", max_bytes=max(num_bytes, _FIRST_BYTES))
