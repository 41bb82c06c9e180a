"""Files and folders that are written whole: beside their place, their files synced, and renamed into it.

Whoever is killed meanwhile leaves the old state, and a hidden `.NAME.????????.tmp` beside it, which the same user takes
away by writing NAME again: its writer holds a lock on it as long as it lives.
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
    """Call `write` with a path beside `path`, sync the file, rename it in. Raises StoreError if the disk refuses."""
    if path.exists() and not path.is_file():
        raise StoreError(f"cannot write {path}: it is there already and no file; choose another name")
    with _beside(path, folder=False) as temporary:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        # mkstemp makes files private; a store is shared like any other data folder.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)


def file_hash(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal digits. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole, as `write_atomic` does. Raises StoreError if the disk refuses."""
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def write_once(path: Path, data: bytes) -> None:
    """Write a private file unless there is one: of several who write it at once, the first one's stays.

    Raises StoreError if the disk refuses.
    """
    with _beside(path, folder=False) as temporary:
        temporary.write_bytes(data)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        with contextlib.suppress(FileExistsError):
            os.link(temporary, path)


@contextlib.contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Make a folder to write into, which takes the name `folder` when the block ends well; otherwise it is removed.

    Raises InputError where `folder` holds something or cannot be replaced, StoreError if the disk refuses.
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
    """A new hidden file or folder beside `path`, locked, and gone at the end. Raises StoreError for any OSError."""
    with contextlib.ExitStack() as cleanup:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_left_over(path, folder)
            yield _make(path, folder, cleanup)
        except OSError as error:
            # pyarrow raises its own OSError without a number; its text then is the reason.
            reason = os.strerror(error.errno) if error.errno else (str(error).splitlines() or [type(error).__name__])[0]
            hint = "; free some space" if error.errno in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT) else ""
            # What is copied into a new folder may be what cannot be read.
            other = str(error.filename or path)
            named = "" if path.is_relative_to(other) or f".{path.name}." in other else f"{other}: "
            raise StoreError(f"cannot write {path}: {named}{reason}{hint}") from None


def _make(path: Path, folder: bool, cleanup: contextlib.ExitStack) -> Path:
    while True:
        if folder:
            name = tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
        else:
            made, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
            os.close(made)
        cleanup.callback(_remove, temporary := Path(name))
        # Until it is locked, another writer may take it for one that was left over.
        with contextlib.suppress(FileNotFoundError):
            handle = os.open(name, os.O_RDONLY)
            cleanup.callback(os.close, handle)
            # Some file systems lock nothing; there nobody takes anything away either.
            with contextlib.suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_EX)
            if temporary.exists():
                return temporary


def _remove_left_over(path: Path, folder: bool) -> None:
    """Remove the temporary files, or folders, that this user's killed writers of `path` left beside it."""
    ours = re.compile(rf"\.{re.escape(path.name)}\.[a-z0-9_]{{8}}\.tmp")
    for entry in list(os.scandir(path.parent)):
        if ours.fullmatch(entry.name):
            with contextlib.suppress(OSError):
                found = entry.stat(follow_symlinks=False)
                kind = stat.S_ISDIR if folder else stat.S_ISREG
                if not kind(found.st_mode) or found.st_uid != os.geteuid():
                    continue
                # It may have become a link or a pipe since.
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
