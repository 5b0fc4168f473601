"""Files: written so that nothing is lost, read only where they are files and have an end."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path`` (same suffix) that takes its place if the block succeeds.

    Missing parent folders are made. On an error the temporary file goes and ``path`` stays as it was.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def open_regular(path: str | Path) -> BinaryIO:
    """A regular file, to be read. Raises OSError, whose strerror says why, for anything else.

    A pipe, a socket or a device is not even opened: that may wait for ever, or do something.
    """
    _require_regular(os.stat(path), path)
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _require_regular(os.fstat(handle), path)  # it may have been exchanged in between
    except OSError:
        os.close(handle)
        raise
    return os.fdopen(handle, "rb")


def read_bytes(path: str | Path, most: int) -> bytes:
    """All of a regular file. Raises OSError as `open_regular`, and for more than ``most`` bytes."""
    with open_regular(path) as file:
        contents = file.read(most + 1)
    if len(contents) > most:
        raise OSError(errno.EFBIG, f"has more than {most} bytes", str(path))
    return contents


def file_name(text: str, otherwise: str = "unnamed") -> str:
    """A name that another has given, as the stem of a file: one that stays in its folder, and can be seen.

    Letters, digits and ``. _ + -`` stay, other characters become ``_``; no dot comes first, and what is left
    after 100 characters goes. ``otherwise`` stands for what has nothing left.
    """
    plain = re.sub(r"[^\w.+-]", "_", text.rpartition("/")[2]).lstrip(".")[:100]
    return plain if plain.strip("_") else otherwise


def _require_regular(status: os.stat_result, path: str | Path) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is no regular file", str(path))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
