"""Files that are complete or absent."""

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file so that at no time a part of it stands under its name, not even after a crash.

    A symbolic link is followed; a device or a pipe is written to. A file that is replaced keeps its permissions.

    Raises:
        OSError: If the file cannot be written; it names the path as given. An older file is as it was.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        mode = None
    if mode is not None and not stat.S_ISREG(mode):
        path.write_bytes(data)  # a device or a pipe, which must not be replaced
        return
    target = path.resolve()  # what a symbolic link points to, not the link
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")  # short, however long the target's name is
    try:
        with open(temporary, "xb") as file:  # whose permissions are those of any new file
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
            raise OSError(error.errno, error.strerror, os.fspath(path)) from error  # not the temporary one
        raise
