"""Atomic writes of files and folders: a temporary file in the same folder is written, synced and renamed.

A process that is killed before the rename leaves the old state and a hidden `.NAME.????????.tmp`. The next write of
NAME by the same user removes that file. A live writer holds a lock on its temporary file, so no process removes it.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from jrdb_avr.schema.errors import InputError, StoreError


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file atomically: let `write` write a temporary file, sync it and rename it to `path`.

    Args:
        path: File to make or replace; its folder is made if it is missing.
        write: Function that writes a file at the path it is given.

    Raises:
        StoreError: The disk refuses, or `path` exists and is not a file.
    """
    if path.exists() and not path.is_file():
        raise StoreError(f"cannot write {path}: it exists and is not a file; choose another name")
    with _beside(path, folder=False) as temporary:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        # mkstemp makes private files, but a store may be shared.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)


def file_hash(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal digits. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file atomically, as `write_atomic` does. Raises StoreError if the disk refuses."""
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def write_once(path: Path, data: bytes) -> None:
    """Write a private file unless it exists. If several processes write it at once, the first file stays.

    Raises:
        StoreError: The disk refuses.
    """
    with _beside(path, folder=False) as temporary:
        temporary.write_bytes(data)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        with contextlib.suppress(FileExistsError):
            os.link(temporary, path)


@contextlib.contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder, and rename it to `folder` when the block ends; remove it if the block raises.

    Args:
        folder: Folder that does not exist or is empty.

    Raises:
        InputError: `folder` is not empty, or cannot be replaced.
        StoreError: The disk refuses.
    """
    folder = folder.resolve()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists and is not empty: name a new folder", file=str(folder))
    if folder == Path.cwd() or folder.is_mount():
        raise InputError(f"{folder} cannot be replaced: name a new folder inside it", file=str(folder))
    with _beside(folder, folder=True) as temporary:
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        temporary.replace(folder)


@contextlib.contextmanager
def _beside(path: Path, *, folder: bool) -> Iterator[Path]:
    """Yield a new locked hidden file or folder beside `path`, and remove it at the end. Map OSError to StoreError."""
    with contextlib.ExitStack() as cleanup:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_left_over(path, folder)
            yield _make(path, folder, cleanup)
        except OSError as error:
            # pyarrow raises OSError without a number; the reason is then its text.
            reason = os.strerror(error.errno) if error.errno else (str(error).splitlines() or [type(error).__name__])[0]
            hint = "; free some space" if error.errno in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT) else ""
            # A file that cannot be read may be the source of a copy. Then the message names it too.
            source = str(error.filename or path)
            prefix = "" if path.is_relative_to(source) or f".{path.name}." in source else f"{source}: "
            raise StoreError(f"cannot write {path}: {prefix}{reason}{hint}") from None


def _make(path: Path, folder: bool, cleanup: contextlib.ExitStack) -> Path:
    while True:
        if folder:
            name = tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
        else:
            descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
            os.close(descriptor)
        cleanup.callback(_remove, temporary := Path(name))
        # Before the lock is taken, another writer may remove the file as one of a killed process. Then make another.
        with contextlib.suppress(FileNotFoundError):
            handle = os.open(name, os.O_RDONLY)
            cleanup.callback(os.close, handle)
            # Some file systems have no locks. There no writer removes temporary files either.
            with contextlib.suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_EX)
            if temporary.exists():
                return temporary


def _remove_left_over(path: Path, folder: bool) -> None:
    """Remove the temporary files, or folders, that killed writers of `path` left, if they belong to this user."""
    pattern = re.compile(rf"\.{re.escape(path.name)}\.[a-z0-9_]{{8}}\.tmp")
    for entry in list(os.scandir(path.parent)):
        if pattern.fullmatch(entry.name):
            with contextlib.suppress(OSError):
                status = entry.stat(follow_symlinks=False)
                is_kind = stat.S_ISDIR if folder else stat.S_ISREG
                if not is_kind(status.st_mode) or status.st_uid != os.geteuid():
                    continue
                # A link or a pipe may have replaced the entry since stat(). So do not follow it, and do not wait.
                handle = os.open(entry.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    _remove(Path(entry.path))
                finally:
                    os.close(handle)


def _remove(temporary: Path) -> None:
    with contextlib.suppress(OSError):
        if temporary.is_dir():
            shutil.rmtree(temporary)
        else:
            temporary.unlink(missing_ok=True)


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask
