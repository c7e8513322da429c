"""Parts of files on static servers, fetched by HTTP ranges, in bounded time and memory."""

import re
import threading
import urllib.error
import urllib.request
from dataclasses import dataclass
from http.client import HTTPException, HTTPResponse

from plr_jax._arrays import shortened

_CHUNK = 1 << 16
_MOST_UNTOLD = 1 << 25
"""Bytes that are read of an answer that does not say how many it has."""
_PARTIAL, _UNSATISFIABLE = 206, 416
_CONTENT_RANGE = re.compile(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})")


@dataclass(frozen=True)
class Fetched:
    """The beginning of a file, as far as it was fetched.

    Attributes:
        data: Those bytes.
        size: Bytes of all of it; None if the server did not say.
        version: What tells this version of the file from others; empty if the server did not say.
        has_ended: Whether a server that did not say how many bytes there are sent no more.
    """

    data: bytes = b""
    size: int | None = None
    version: str = ""
    has_ended: bool = False

    @property
    def is_complete(self) -> bool:
        """Whether that is all of it, as far as the server tells."""
        return self.has_ended or len(self.data) == self.size


def fetch(url: str, end: int, timeout: float, known: Fetched | None = None) -> Fetched:
    """The first ``end`` bytes of a file, or all of a shorter one, in one request for what is not known yet.

    A server that knows no ranges is not read farther either.

    Raises:
        OSError: If the server cannot be reached, takes longer than so many seconds, or answers with an error.
        ValueError: If it answers with something else than what was asked for, or the file has changed.
    """
    known = Fetched() if known is None else known
    outcome: list[Fetched | BaseException] = []
    given_up = threading.Event()

    def request() -> None:
        try:
            outcome.append(_request(url, end, timeout, known, given_up))
        except BaseException as error:  # to be raised where it was asked for
            outcome.append(error)

    # In a thread of its own: a server that sends a byte now and then keeps any single read from timing out.
    thread = threading.Thread(target=request, daemon=True)
    thread.start()
    thread.join(timeout)
    if not outcome:
        given_up.set()
        raise TimeoutError(f"{url} did not send what was asked for within {timeout:g} s.")
    if isinstance(outcome[0], BaseException):
        raise outcome[0]
    return outcome[0]


def _request(url: str, end: int, timeout: float, known: Fetched, given_up: threading.Event) -> Fetched:
    start = len(known.data)
    headers = {"Range": f"bytes={start}-{end - 1}", "Accept-Encoding": "identity", "User-Agent": "plr_jax"}
    try:
        with _opener().open(urllib.request.Request(url, headers=headers), timeout=timeout) as response:
            return _answer(url, response, end, known, given_up)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == _UNSATISFIABLE:
            raise ValueError(f"{url} has no bytes beyond the first {start}.") from None
        raise OSError(f"{url} answered {error.code} {shortened(error.reason)}.") from None
    except urllib.error.URLError as error:
        raise OSError(f"{url} cannot be reached: {error.reason}.") from None
    except (HTTPException, UnicodeError) as error:
        raise OSError(
            f"{url} does not answer as a web server does: {type(error).__name__} {shortened(str(error))}."
        ) from None


def _opener() -> urllib.request.OpenerDirector:
    """What opens web pages and follows them where they have moved, but to nothing else, such as files."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler,
        urllib.request.UnknownHandler,
        urllib.request.HTTPHandler,
        urllib.request.HTTPSHandler,
        urllib.request.HTTPDefaultErrorHandler,
        urllib.request.HTTPRedirectHandler,
        urllib.request.HTTPErrorProcessor,
    ):
        opener.add_handler(handler())
    return opener


def _answer(url: str, response: HTTPResponse, end: int, known: Fetched, given_up: threading.Event) -> Fetched:
    """What was known, and what an answer adds to it."""
    if (encoding := response.headers.get("Content-Encoding", "identity")).lower() != "identity":
        raise ValueError(f"{url} is sent as {encoding!r}; the server should send it as it is.")
    version = response.headers.get("ETag") or response.headers.get("Last-Modified") or ""
    start, size = 0, response.length
    if response.status == _PARTIAL:
        match = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
        if match is None or int(match[1]) != len(known.data) or int(match[2]) >= end:
            raise ValueError(f"{url} was asked for bytes {len(known.data)} to {end - 1}, and sent others.")
        start, size = int(match[1]), int(match[3])
        end = int(match[2]) + 1
    end = min(end, start + _MOST_UNTOLD if size is None else size)
    sent = _read(response, end - start, given_up)
    data = known.data[:start] + sent
    is_changed = start == 0 and not data.startswith(known.data)
    if is_changed or (known.data and (size, version) != (known.size, known.version)):
        raise ValueError(f"{url} has changed since it was first asked for.")
    if len(data) < end and size is not None:
        raise OSError(f"{url} broke off after {len(data)} of {end} bytes.")
    return Fetched(data, size, version, has_ended=size is None and len(data) < end)


def _read(response: HTTPResponse, count: int, given_up: threading.Event) -> bytes:
    """So many bytes, or what there is until nobody waits for them any more."""
    data = bytearray()
    while len(data) < count and not given_up.is_set() and (part := response.read1(min(count - len(data), _CHUNK))):
        data += part
    return bytes(data)
