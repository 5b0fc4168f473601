"""An .npz from outside: what it would become is looked at before any of it is unpacked."""

from __future__ import annotations

import contextlib
import json
import math
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import EladaptError
from eladapt.files import open_regular

HEADER = "header"
MOST_HEADER = 64 << 20  # [bytes]: four a character, of a robot file of 5 MB and more; a Panda's has 0.1 MB
MOST_ARRAYS = 1000
READ_HEAD = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@contextlib.contextmanager
def reading(path: Path, what: str, writer: str, error: type[EladaptError]) -> Iterator[None]:
    """Whatever a file from outside makes its readers raise is an ``error``, which names the file."""
    try:
        yield
    except error:
        raise
    except FileNotFoundError:
        raise error(f"{path}: no such {what}; {writer} writes one") from None
    except Exception as reason:  # zlib's, json's, the stack's: a file that was forged picks one
        said = getattr(reason, "strerror", None) or str(reason) or type(reason).__name__
        raise error(f"{path}: not a {what}, or a damaged one ({said}); {writer} writes one") from reason


def read_archive(path: Path, free: int, ratio: float) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The header, from JSON, and the arrays by name of a file that `numpy.savez` wrote with them.

    What they take in memory is at most ``free`` bytes, or ``ratio`` times what the file has. Raises OSError
    for what is no regular file, and whatever a broken or a forged one makes zipfile, numpy and json raise.
    """
    with open_regular(path) as file, zipfile.ZipFile(file) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        if len(members) > MOST_ARRAYS or len(members) < len(archive.infolist()):
            raise ValueError(f"expected at most {MOST_ARRAYS} arrays, each of a name of its own")
        size, total = os.fstat(file.fileno()).st_size, sum(member.file_size for member in members.values())
        if total > max(free, ratio * size):
            raise ValueError(f"its {size} bytes would become {total}")
        if HEADER not in members or members[HEADER].file_size > MOST_HEADER:
            raise ValueError(f"expected a header of at most {MOST_HEADER} bytes")
        arrays = {name: _array(archive, member) for name, member in members.items()}
    header = json.loads(str(arrays.pop(HEADER)))
    if not isinstance(header, dict):
        raise ValueError("its header names nothing")
    return header, arrays


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """The array in a member, if that is as large as the array says that it is."""
    with archive.open(member) as file:
        shape, _, kind = READ_HEAD[np.lib.format.read_magic(file)](file)
        declared = math.prod(shape) * kind.itemsize
        if kind.hasobject or not kind.itemsize or file.tell() + declared != member.file_size:
            raise ValueError(f"{member.filename}: {shape} of {kind} in {member.file_size} bytes")
    with archive.open(member) as file:
        return np.lib.format.read_array(file, allow_pickle=False)
