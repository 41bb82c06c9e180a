"""Atomic writes of files and folders.

The content of a file NAME is written to a temporary file in the same folder. The temporary file is then synced to the
disk and renamed. If a process is killed before the rename, the old file stays, and a hidden file `.NAME.????????.tmp`
is left over. When another process of the same user writes NAME, it removes the left-over file. A running writer holds a
lock on its temporary file, so that other processes do not remove the temporary file.
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
from typing import IO, Any

from jrdb_avr.schema.errors import InputError, StoreError


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file atomically: call `write` for a temporary file, sync that file, and rename it to `path`.

    Args:
        path: File to create or replace. Its folder is created if it does not exist.
        write: Function that writes the content. It is called once with the path of the temporary file.

    Raises:
        StoreError: If the file cannot be written, or `path` exists and is not a file.
    """
    if path.exists() and not path.is_file():
        raise StoreError(f"cannot write {path}: it exists and is not a file; choose another name")
    with _beside(path, folder=False) as temporary:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        # mkstemp creates files that only the user can read, but other users may share a store.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)


def sync_folder(folder: Path) -> None:
    """Sync a folder to the disk, so that a new file in it survives a crash. Raise OSError if syncing fails."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def file_hash(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal digits. Raises OSError if the file cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file atomically. Raises StoreError if the file cannot be written."""
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def write_once(path: Path, data: bytes) -> None:
    """Create a file that only this user can read. If the file exists already, leave it unchanged.

    If several processes call this function at the same time, the file keeps the content of the first process.

    Args:
        path: File to create.
        data: Content of the file.

    Raises:
        StoreError: If the file cannot be written.
    """
    with _beside(path, folder=False) as temporary:
        temporary.write_bytes(data)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        with contextlib.suppress(FileExistsError):
            os.link(temporary, path)


@contextlib.contextmanager
def new_folder(folder: Path, mode: int = 0o777) -> Iterator[Path]:
    """Yield a temporary folder, and rename it to `folder` when the `with` block ends.

    If the block raises an exception, the temporary folder is removed, and `folder` does not change.

    Args:
        folder: Folder to create. If it exists already, it must be empty.
        mode: Permissions of the folder, before the umask.

    Yields:
        The temporary folder, which is in the same parent folder as `folder`.

    Raises:
        InputError: If `folder` is not empty or cannot be replaced.
        StoreError: If the folder cannot be written.
    """
    folder = folder.resolve()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists and is not empty: name a new folder", file=str(folder))
    if folder == Path.cwd() or folder.is_mount():
        raise InputError(f"{folder} cannot be replaced: name a new folder inside it", file=str(folder))
    with _beside(folder, folder=True) as temporary:
        yield temporary
        temporary.chmod(mode & ~_umask())
        temporary.replace(folder)


def lock_file(file: IO[Any], *, shared: bool = False) -> bool:
    """Lock an open file until it is closed.

    Args:
        file: The file.
        shared: True for a lock that several processes may hold.

    Returns:
        False if another process holds the lock.

    Raises:
        StoreError: If the file system has no locks.
    """
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        advice = "put the store on a local disk, or mount this file system with locks (Lustre: -o flock)"
        raise StoreError(f"{file.name}: its file system has no locks ({error.strerror}): {advice}") from None
    return True


@contextlib.contextmanager
def _beside(path: Path, *, folder: bool) -> Iterator[Path]:
    """Yield a locked temporary file or folder beside `path`, and remove it afterwards. Turn OSError into StoreError."""
    with contextlib.ExitStack() as cleanup:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_left_over(path, folder)
            yield _make(path, folder, cleanup)
        except OSError as error:
            # pyarrow raises OSError without an errno. The text of the error is then the reason.
            reason = os.strerror(error.errno) if error.errno else (str(error).splitlines() or [type(error).__name__])[0]
            hint = "; free some space" if error.errno in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT) else ""
            # If the error concerns another file, such as the source of a copy, the message names that file too.
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
        # Before the lock is held, another writer may remove the file as a left-over. In this case, make a new file.
        with contextlib.suppress(FileNotFoundError):
            handle = os.open(name, os.O_RDONLY)
            cleanup.callback(os.close, handle)
            # Ignore file systems without locks. No writer removes left-over files there, because that needs a lock too.
            with contextlib.suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_EX)
            if temporary.exists():
                return temporary


def _remove_left_over(path: Path, folder: bool) -> None:
    """Remove the temporary files (or folders) that killed writers of `path` left over, if this user owns them."""
    pattern = re.compile(rf"\.{re.escape(path.name)}\.[a-z0-9_]{{8}}\.tmp")
    for entry in list(os.scandir(path.parent)):
        if pattern.fullmatch(entry.name):
            with contextlib.suppress(OSError):
                status = entry.stat(follow_symlinks=False)
                is_kind = stat.S_ISDIR if folder else stat.S_ISREG
                if not is_kind(status.st_mode) or status.st_uid != os.geteuid():
                    continue
                # After stat(), a link or a pipe may replace the entry. Do not follow links, and do not wait for pipes.
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
