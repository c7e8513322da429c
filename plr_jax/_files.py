"""Safe reading of text, JSON and YAML files, and atomic writing of files.

A file may have at most 16 MiB by default, at most 32 levels of nesting, and only integers that fit into a float. YAML
aliases and tags are rejected: with aliases, a few bytes can expand to any size. For bad content, readers raise
``ValueError`` and no other exception.
"""

import json
import os
import re
import secrets
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from plr_jax._arrays import shortened

StrPath: TypeAlias = str | os.PathLike[str]
_MOST_BYTES = 2**24
_MOST_NESTED = 32
_LONGEST_WORD = 1000  # most characters of an unquoted YAML word; finding its type may take quadratic time
_LARGEST_INTEGER = int(np.finfo(np.float64).max)


def file_path(path: object) -> Path:
    """Convert a file name, a ``str`` or ``os.PathLike``, to a ``Path``; any other type raises ``ValueError``."""
    if not isinstance(path, str | os.PathLike):
        got = f"{shortened(path)}."
        if isinstance(path, bytes | bytearray | memoryview):
            got = f"{len(path):,} bytes. For the content of a PLR's file use from_bytes."
        raise ValueError(f"path must be the name of a file, a str or a Path, got {got}")
    return Path(os.fsdecode(path))


@contextmanager
def errors_named(path: StrPath) -> Iterator[Path]:
    """Yield the path of a file. If the ``with`` block raises a ``ValueError``, put the path before its message."""
    path = file_path(path)
    try:
        yield path
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def text_of(path: Path, most_bytes: int = _MOST_BYTES) -> str:
    """Read a text file in UTF-8, with or without a byte order mark.

    ``ValueError`` is raised if the file has more than ``most_bytes`` bytes, or is not UTF-8.
    """
    with path.open("rb") as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise ValueError(f"expected at most {most_bytes:,} bytes, got a larger file.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"expected text in UTF-8, got a binary file ({error}).") from None


def json_of(path: Path, most_bytes: int = _MOST_BYTES) -> Any:
    """Read and decode a JSON file of at most ``most_bytes`` bytes, within the limits that this module states."""
    text = text_of(path, most_bytes)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"expected JSON, got something else or a damaged file ({error}).") from None
    _require_limits(value)
    return value


def yaml_of(path: Path) -> Any:
    """Read and decode a YAML file, within the limits that this module states."""
    import yaml

    text = text_of(path)
    loader = _loader()
    try:
        # 1. Refuse deep nesting, aliases, tags and long unquoted words, for which a parser could need too much memory
        #    or time. Events come from `parse` before any value is made.
        nested = 0
        for event in yaml.parse(text, loader):
            nested += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            _require_shallow(nested)
            if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None):
                line = event.start_mark.line + 1
                raise ValueError(f"neither aliases nor tags are read, got one in line {line}: write the value")
            if isinstance(event, yaml.ScalarEvent) and event.implicit[0] and len(event.value) > _LONGEST_WORD:
                got = len(event.value)
                raise ValueError(f"expected at most {_LONGEST_WORD} characters without quotes, got {got}")
        # 2. Decode.
        value = yaml.load(text, loader)
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f"expected YAML ({error}).") from None
    _require_limits(value)
    return value


@cache
def _loader() -> Any:
    """Return a safe PyYAML loader class that also reads words such as 1e-05 as numbers."""
    import yaml

    # A new class, because adding a resolver changes the class. CSafeLoader is faster, where it is installed.
    loader: Any = type("Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
    # YAML 1.1 reads 1e-05 as a string, but C++ writes numbers like this.
    number = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$", re.ASCII)
    loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+.0123456789"))
    return loader


def require_format(document: Any, kind: str, version: int, keys: Sequence[str]) -> None:
    """Raise a ``ValueError`` unless a decoded file has the given kind, at most the given version, and all ``keys``.

    In ``document``, the decoded file, "format" must be :func:`format_name` of the ``kind``, and "version" an integer
    of at least 1.
    """
    if not isinstance(document, dict) or document.get("format") != format_name(kind):
        raise ValueError(f'expected a {kind} file, with "format": "{format_name(kind)}".')
    stated = document.get("version")
    if not isinstance(stated, int) or isinstance(stated, bool) or stated < 1:
        raise ValueError(f"expected a version number of at least 1, got {shortened(stated)}.")
    if stated > version:
        raise ValueError(f"the file has version {stated}, this release reads up to {version}: update plr-jax.")
    missing = [key for key in keys if key not in document]
    if missing:
        raise ValueError(f"expected the keys {', '.join(keys)}; missing {', '.join(missing)}.")


def format_name(kind: str) -> str:
    return f"plr_jax {kind}"


def _require_limits(value: Any) -> None:
    """Raise a ``ValueError`` if a decoded document has deep nesting, or integers that are too large for floats."""
    # Level by level, so that deep nesting cannot overflow the stack.
    level = [value]
    nested = 0
    while level:
        if any(isinstance(entry, int) and abs(entry) > _LARGEST_INTEGER for entry in level):
            raise ValueError(f"expected numbers up to {float(_LARGEST_INTEGER):.2g}, got a larger integer.")
        lists = [entry for entry in level if isinstance(entry, list | dict)]
        level = [item for entry in lists for item in (entry.values() if isinstance(entry, dict) else entry)]
        nested += bool(lists)
        _require_shallow(nested)


def _require_shallow(nested: int) -> None:
    if nested > _MOST_NESTED:
        raise ValueError(f"expected lists and mappings at most {_MOST_NESTED} deep, got deeper ones")


def write_atomically(path: Path, data: bytes) -> None:
    """Write ``data`` to a file so that, even after a crash, the file is either complete or unchanged.

    Devices and pipes are written directly, without this guarantee.
    """
    # 1. Write to a device or pipe directly: it must not be replaced.
    mode = None
    with suppress(FileNotFoundError):
        mode = os.stat(path).st_mode
    if mode is not None and not stat.S_ISREG(mode):
        path.write_bytes(data)
        return
    # 2. Write a temporary file beside the target, and rename it, which replaces the target in one step. The target of
    #    a symbolic link is replaced, not the link. The temporary name is short: the target's may have maximum length.
    target = path.resolve()
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with open(temporary, "xb") as file:
            if mode is not None:
                os.chmod(temporary, stat.S_IMODE(mode))
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and error.errno is not None:
            raise OSError(error.errno, error.strerror, os.fspath(path)) from error  # not the temporary path
        raise
