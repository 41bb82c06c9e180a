"""Files of text that a user names: links and pipes are followed, and byte order marks are removed."""

from __future__ import annotations

import codecs
import os
import stat
from pathlib import Path
from typing import Final

from jrdb_avr.schema.errors import InputError

_MARKS: Final[dict[str, tuple[bytes, ...]]] = {
    "utf-8-sig": (codecs.BOM_UTF8,),
    "utf-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE),
    "utf-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE),
}
"""Byte order marks by encoding. A mark of UTF-32 may begin with a mark of UTF-16, so UTF-32 comes first."""


def read_input(path: Path, largest: int = 1 << 24) -> bytes:
    """Read a file, the file behind a link, or a pipe such as /dev/stdin. Folders and devices are refused.

    Args:
        path: The file.
        largest: Maximum size in bytes.

    Returns:
        The bytes of the file.

    Raises:
        InputError: If the file is missing, is larger than `largest`, or is neither a regular file nor a pipe.
    """
    try:
        # The open does not block, because otherwise the open of a pipe would wait for a writer.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            if stat.S_IFMT(os.fstat(file.fileno()).st_mode) not in (stat.S_IFREG, stat.S_IFIFO):
                raise InputError(f"{path} is neither a file nor a pipe", file=str(path))
            os.set_blocking(file.fileno(), True)
            data = file.read(largest + 1)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path}: {getattr(error, 'strerror', error)}", file=str(path)) from None
    if len(data) > largest:
        raise InputError(f"{path} is larger than {largest >> 20} MB", file=str(path))
    return data


def to_utf8(data: bytes, path: Path) -> bytes:
    """Return text as UTF-8 without a byte order mark. Notepad and PowerShell write marks, and UTF-16.

    Args:
        data: The bytes of a file.
        path: The path of the file, for messages.

    Returns:
        The text in UTF-8. Bytes without a mark are returned unchanged.

    Raises:
        InputError: If the bytes do not fit their mark, or have no mark and seem to be UTF-16.
    """
    encoding = next((name for name, marks in _MARKS.items() if data.startswith(marks)), "")
    if not encoding and b"\0" in data[:4]:
        raise InputError(f"{path} seems to be UTF-16 without a byte order mark: save it as UTF-8", file=str(path))
    try:
        return data.decode(encoding).encode() if encoding else data
    except UnicodeDecodeError as error:
        raise InputError(f"{path} cannot be read as text ({error}): save it as UTF-8", file=str(path)) from None
