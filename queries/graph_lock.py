"""The lock of a graph file: one writer, or any number of readers, told by name to whoever comes in between."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from pathlib import Path
from typing import IO, Final

from jrdb_avr.schema.errors import LockedError, StoreError

WORLD_PROCESS: Final = "jrdb_avr.queries.world_process"
"""The module that runs as the process of a world model; the last argument is its parent's number."""

ENDING_S: Final = 5.0
"""Longest wait for a lock whose holder is about to end."""


def lock_graph(path: Path, *, shared: bool) -> IO[str] | None:
    """Take the side-file lock of a graph, until the file returned is closed.

    Raises LockedError naming the holder. Returns None for reading in a folder where nobody can write.
    """
    place = path.with_name(path.name + ".lock")
    try:
        file = place.open("a+")
    except OSError as error:
        if shared and path.exists():
            try:
                file = place.open("r")
            except OSError:
                return None
        else:
            raise StoreError(f"cannot use {path}: {error.strerror}; check the --store folder") from None
    end = time.monotonic() + ENDING_S
    while True:
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            break
        except OSError:
            holder, ends = _holder(file)
            if not ends or time.monotonic() > end:
                file.close()
                raise LockedError(f"{path} is in use by {holder}: wait for it, or end it", holder=holder) from None
            time.sleep(0.02)
    if not shared:
        file.truncate(0)
        file.write(f"process {os.getpid()}")
        file.flush()
    return file


def _holder(file: IO[str]) -> tuple[str, bool]:
    """Who holds the lock, by the kernel's table where there is one, else by what the last writer noted; and whether
    that process is about to end: it has no command any more, or was the helper of one that is gone. One that the
    kernel's table does not name, or that is gone before it is looked at, has let go of the lock meanwhile.
    """
    ends = False
    inode = str(os.fstat(file.fileno()).st_ino)
    with contextlib.suppress(OSError):
        locks = Path("/proc/locks").read_text()
        ends = True
        for line in locks.splitlines():
            fields = line.split()
            if "FLOCK" in fields and len(fields) > 5 and fields[5].rpartition(":")[2] == inode and fields[4] != "-1":
                holder, leaves = fields[4], False
                command = _command(holder)
                if WORLD_PROCESS in command:
                    # It works for its parent, which is the one to wait for.
                    leaves = Path("/proc", holder, "stat").read_text().rpartition(")")[2].split()[1] != command[-1]
                    if not leaves:
                        holder = command[-1]
                        command = _command(holder)
                return f"process {holder} ({' '.join(command)[:120]})", leaves or not command
    file.seek(0)
    return file.read(100).strip() or "another process", ends


def _command(process: str) -> list[str]:
    """The words of a process's command; none where it is about to end."""
    words = Path("/proc", process, "cmdline").read_bytes().decode(errors="replace").rstrip("\0")
    return words.split("\0") if words else []
