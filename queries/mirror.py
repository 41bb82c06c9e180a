"""Stores and panoramas at a URL: their files are fetched into a folder of this machine's cache, and changes sent back.

A `Mirror` is a store's folder in the cache. Opening fetches what differs there; whoever changes the store sends what
differs here: the tables first and the manifests last, so that a reader elsewhere takes no half of a change for a whole.
What is told apart by its hash in the manifest is sent and fetched only where that differs; everything else by its size
and time, of the question files also by the server's own tag. The graph is never sent.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import itertools
import os
import secrets
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import msgspec

from jrdb_avr.queries.files import write_bytes
from jrdb_avr.queries.graph.file import STORE_GRAPH, remove_files
from jrdb_avr.queries.manifest import MANIFEST_NAME, Manifest, is_url
from jrdb_avr.queries.remote import RemoteFolder, is_plain_path
from jrdb_avr.schema.errors import StoreError

TABLES: Final = ("annotations/", "intervals/", "questions/", MANIFEST_NAME)
"""What the holder of a store's writer lock sends."""

RUNS: Final = ("runs/", "conventions/", "opaque.key")
"""What runs write. A change that a killed run could not send is kept, and sent by the next one."""

SEND_EVERY_S: Final = 60.0
"""Seconds between two times at which a run that goes on sends its journal."""

_AT_ONCE: Final = 8
_FIRST: Final = "run.json"
_LAST: Final = ("predictions.parquet", "scores.parquet", "questions.parquet", MANIFEST_NAME)
"""Names of the files that make others valid, in the order in which they are sent after those."""

_ABSENT: Final = (-1, 0)

_TURN: Final = "turn"
"""Name of the file at the URL that each writer of tables replaces first, if it still is the one that it knows."""

OPENED: Final[dict[Path, tuple[str, tuple[str, ...]]]] = {}
"""The folders of the mirrors that this process has fetched, each with its URL and the parts that sequences need."""


def image_path(root: str | Path, name: str) -> Path:
    """The path on this machine of a panorama that lies in a folder or at a URL, from where it is fetched once.

    Raises StoreError where it cannot be fetched.
    """
    if not is_url(root):
        return Path(root, name)
    mirror = Mirror(root)
    if not (mirror.folder / name).exists():
        mirror.fetch_file(name)
    return mirror.folder / name


def has_images(root: str | Path, sequence: str) -> bool:
    """Whether a sequence has a panorama below a folder or URL. Raises StoreError where a URL cannot be reached."""
    if is_url(root):
        return any(name.endswith(".jpg") for name in RemoteFolder(root).files(f"{sequence}/", below=False))
    return any(Path(root, sequence).glob("*.jpg"))


class Known(msgspec.Struct, array_like=True):
    """What a file was there, and here (bytes and time of change in ns), when both were last the same."""

    there: str
    here: tuple[int, int]


class Mirror:
    """A folder of the cache that stands for a URL. Making one checks the URL and reaches nothing."""

    def __init__(self, url: str, place: Path | None = None) -> None:
        """`place` is another folder than that of the cache. Raises InputError as `RemoteFolder`."""
        self._remote = RemoteFolder(url)
        self.url = self._remote.url
        self._place = place or _cache() / hashlib.sha256(self.url.encode()).hexdigest()[:20]
        self.folder = self._place / "files"

    # -- there to here ----------------------------------------------------------------------------------------

    def fetch(self) -> None:
        """Make the folder what the store at the URL is, but for what runs wrote here and could not send.

        While another process here writes the store, its files stay as they are. Raises StoreError.
        """
        OPENED[self.folder] = self.url, (*TABLES[:2], MANIFEST_NAME)
        with self._known() as known:
            if self._is_written():
                return
            # Before all else: who takes the turn from now on may change anything.
            turn = self._remote.tag(_TURN) if self._remote.files(_TURN) else None
            there, here = self._there((*TABLES, *RUNS)), self._here((*TABLES, *RUNS))
            unsent = {name for name, at in here.items() if name.startswith(RUNS) and not _same(known, name, here=at)}
            news = {name for name, at in there.items() if not _same(known, name, there=at)}
            foreign = {name for name in unsent & news if not self._remote.begins(self.folder / name, name)}
            others = {name for name in {*map(_run_manifest, unsent)} & news if self._is_of_another_run(name)}
            for name in [name for name in unsent if name in foreign or _run_manifest(name) in others]:
                # Both went on: what was sent counts, and the answers here, maybe another model's, are not lost.
                path = self.folder / name
                path.rename(path.with_name(f".{path.name}.unsent"))
                unsent.remove(name)
                del here[name]
            # Sent by a run that ended before it could note this.
            known |= {name: Known(there[name], _ABSENT) for name in unsent & news}
            news -= unsent
            differing = news | {n for n in there if n not in unsent and not _same(known, n, here=here.get(n, _ABSENT))}
            gone = here.keys() - there.keys() - unsent
            if MANIFEST_NAME in differing | gone:
                remove_files((self.folder / STORE_GRAPH).resolve())
            for name in gone:
                (self.folder / name).unlink()
            for name in known.keys() - there.keys():
                del known[name]
            if turn is not None:
                known[_TURN] = Known(turn, _ABSENT)
            self._fetch(there, differing, known)

    def fetch_root(self) -> None:
        """Fetch the label files of a JRDB root; its panoramas become empty files of their names. Raises StoreError."""
        OPENED[self.folder] = self.url, ("",)
        with self._known() as known:
            there = self._there(("",))
            for name in self._here(("",)).keys() - there.keys():
                (self.folder / name).unlink()
            self._fetch_some(there, known)

    def fetch_sequence(self, parts: tuple[str, ...], sequence: str, graph: Mapping[str, bytes]) -> None:
        """Fetch what a sequence has in those parts, and what all sequences share; and put the files of a graph there.

        Raises StoreError.
        """
        with self._known() as known:
            there = self._there(parts)
            own = {name: at for name, at in there.items() if sequence in _words(name) or not _words(name)}
            self._fetch_some(own, known)
            for name, data in graph.items():
                path = self.folder / name
                if not path.exists() or path.read_bytes() != data:
                    write_bytes(path, data)

    # -- here to there ----------------------------------------------------------------------------------------

    def send(self, parts: Iterable[str]) -> None:
        """Make those parts of the store at the URL what they are here.

        Raises StoreError, and changes nothing, where another writer changed one of those files since it was fetched.
        """
        parts = tuple(parts)
        with self._known() as known:
            here = self._here(parts)
            changed = [name for name, at in here.items() if not _same(known, name, here=at)]
            gone = [name for name in known if name.startswith(parts) and name not in here]
            if not changed and not gone:
                return
            there = self._there(parts)
            manifest = self.folder / MANIFEST_NAME
            hashes = _table_hashes(manifest.read_bytes() if manifest.exists() else b"")
            # Tables that a load made anew are most often what they were.
            changed = [name for name in changed if name not in hashes or hashes[name] != there.get(name)]
            guard = {MANIFEST_NAME} & {*parts}
            for name in sorted({*changed, *gone, *guard, *map(_run_manifest, [*changed, *gone])}):
                self._refuse(name, there.get(name), known[name].there if name in known else None)
            if guard:
                self._take_turn(known)
            if MANIFEST_NAME in {*changed} & there.keys() and any(n.startswith(TABLES[:2]) for n in [*changed, *gone]):
                # Until the new one is there, nobody takes the tables of two loads for a store.
                self._remote.delete(MANIFEST_NAME)
                del there[MANIFEST_NAME]
            # First, as on a disk: no reader finds evidence of dropped questions beside new ones.
            for name in gone:
                if name in there:
                    self._remote.delete(name)
                del known[name]
            sent: list[str] = []
            try:
                self._send_waves(changed, there, sent)
            except StoreError:
                # A run goes on, and what it has sent by now is no other writer's.
                of_runs = [name for name in sent if name.startswith(RUNS)]
                with contextlib.suppress(StoreError):
                    known.update({name: Known(at, here[name]) for name, at in self._there(of_runs).items()})
                raise
            there = self._there(parts)
            known.update({name: Known(there[name], stamp) for name, stamp in here.items() if name in there})

    @contextlib.contextmanager
    def sending(self, parts: Iterable[str]) -> Iterator[None]:
        """Send those parts every minute, and when the block ends, also where an error ends it."""
        ended = threading.Event()

        def regularly() -> None:
            while not ended.wait(SEND_EVERY_S):
                # What cannot be sent now may be sent the next time.
                with contextlib.suppress(StoreError):
                    self.send(parts)

        thread = threading.Thread(target=regularly, name="send", daemon=True)
        thread.start()
        try:
            yield
        except BaseException:
            with contextlib.suppress(StoreError):
                self.send(parts)
            raise
        else:
            self.send(parts)
        finally:
            ended.set()
            thread.join()

    def _is_of_another_run(self, name: str) -> bool:
        """Whether the manifest of a run at the URL is of one that was begun another time than that here."""
        path = self.folder / name
        return _begun(path.read_bytes() if path.exists() else b"") != _begun(self._remote.read(name))

    def _take_turn(self, known: dict[str, Known]) -> None:
        """Have all writers refused from now on that have fetched the store before; or be refused by one of them."""
        tag = self._remote.replace(_TURN, secrets.token_bytes(16), known[_TURN].there if _TURN in known else None)
        if tag is None:
            self._refuse(_TURN, None, "")
        elif tag:
            known[_TURN] = Known(tag, _ABSENT)

    def _refuse(self, name: str, there: str | None, expected: str | None) -> None:
        if there != expected:
            raise StoreError(
                f"{self.url} was changed by another writer since it was read ({name}): run the command again, a run "
                "under another --run-id"
            )

    # -- files ------------------------------------------------------------------------------------------------

    def _there(self, parts: Iterable[str]) -> dict[str, str]:
        """The files of those parts at the URL, each with what tells its content from another."""
        found: dict[str, str] = {}
        for part in parts:
            found |= self._remote.files(part)
        for name in found:
            # Not of the evidence, a file per sequence: the others change whenever it does.
            if name.startswith("questions/") and name.count("/") == 1:
                found[name] = self._remote.tag(name) or found[name]
        if MANIFEST_NAME in parts:
            manifest = self._remote.read(MANIFEST_NAME) if MANIFEST_NAME in found else b""
            if manifest:
                found[MANIFEST_NAME] = hashlib.sha256(manifest).hexdigest()
            hashes = _table_hashes(manifest)
            # Tables that the manifest does not name are no part of the store.
            found = {n: hashes.get(n, at) for n, at in found.items() if n in hashes or not n.startswith(TABLES[:2])}
        return found

    def _here(self, parts: tuple[str, ...]) -> dict[str, tuple[int, int]]:
        """The files of those parts in the folder; hidden ones are nobody else's, and no link is followed."""
        found = {}
        for part in parts:
            below = self.folder / part
            if below.resolve() != self.folder.resolve() / part:
                continue
            paths = [below] if part and not part.endswith("/") else _plain_files(below)
            for path in paths:
                with contextlib.suppress(FileNotFoundError):
                    found[path.relative_to(self.folder).as_posix()] = _stamp(path)
        return found

    def _fetch(self, there: dict[str, str], names: Collection[str], known: dict[str, Known]) -> None:
        # The manifest comes last, as everywhere.
        for _, wave in itertools.groupby(sorted(names, key=_wave), _wave):
            for name in _each(self.fetch_file, list(wave)):
                known[name] = Known(there[name], _stamp(self.folder / name))

    def _fetch_some(self, there: dict[str, str], known: dict[str, Known]) -> None:
        """Fetch files that differ; of pictures an empty file."""
        here = self._here(("",))
        for name in there:
            if name.lower().endswith(".jpg"):
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                (self.folder / name).touch()
        read = [name for name in there if name.lower().endswith((".json", ".yaml", ".txt", ".parquet"))]
        self._fetch(there, [n for n in read if not _same(known, n, there[n], here.get(n, _ABSENT))], known)

    def fetch_file(self, name: str) -> str:
        """Fetch one file; returns its name. Raises StoreError."""
        self._remote.fetch(name, self.folder / name)
        return name

    def _send_waves(self, names: Iterable[str], there: Mapping[str, str], sent: list[str]) -> None:
        """Send files, those last that make others valid; each is added to `sent` when it is there."""

        def send(name: str) -> str:
            sent.append(self._send_one(name))
            return name

        for wave, group in itertools.groupby(sorted(names, key=_wave), _wave):
            own = list(group)
            if wave > 1 and own[0].startswith(TABLES):
                self._refuse(own[0], self._there(own).get(own[0]), there.get(own[0]))
            list(_each(send, own))

    def _send_one(self, name: str) -> str:
        self._remote.send(self.folder / name, name)
        return name

    # -- state ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _known(self) -> Iterator[dict[str, Known]]:
        """What was the same at both ends, written back at the end; one process at a time."""
        state = self._place / "state.json"
        try:
            self._place.mkdir(mode=0o700, parents=True, exist_ok=True)
            self.folder.mkdir(exist_ok=True)
            lock = (self._place / "lock").open("a")
        except OSError as error:
            raise StoreError(f"cannot write to {self._place}: {error.strerror}; set JRDB_AVR_CACHE") from None
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            try:
                known = msgspec.json.decode(state.read_bytes(), type=dict[str, Known])
            except (OSError, msgspec.DecodeError, UnicodeDecodeError):
                known = {}
            try:
                yield known
            finally:
                write_bytes(state, msgspec.json.encode(known))

    def _is_written(self) -> bool:
        """Whether a process holds the writer lock of the folder's store (`Store.writing`)."""
        with contextlib.suppress(FileNotFoundError), (self.folder / ".writing").open("a") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                return True
        return False


def _cache() -> Path:
    own = os.environ.get("JRDB_AVR_CACHE")
    return Path(own) if own else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jrdb-avr"


def _each(function: Callable[[str], str], names: Collection[str]) -> Iterator[str]:
    """Call a function for every name, several at a time."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        yield from pool.map(function, names)


def _wave(name: str) -> int:
    last = name.rpartition("/")[2]
    return 0 if last == _FIRST else 2 + _LAST.index(last) if last in _LAST else 1


_SHARED: Final = ("calibration", MANIFEST_NAME)


def _words(name: str) -> set[str]:
    """The names of folders and files, also without suffix, in a path; none of a file that all sequences share."""
    parts = name.split("/")
    return set() if any(own in _SHARED for own in parts) else {*parts, Path(name).stem}


def _same(known: Mapping[str, Known], name: str, there: str | None = None, here: tuple[int, int] | None = None) -> bool:
    """Whether a file is known, and is what it was where it is given what it is now."""
    entry = known.get(name)
    return entry is not None and there in (None, entry.there) and here in (None, entry.here)


def _run_manifest(name: str) -> str:
    """The manifest of the run that a file of `runs/` is of."""
    return "/".join([*name.split("/")[:2], _FIRST])


class _Begun(msgspec.Struct):
    created: str


def _begun(manifest: bytes) -> str | None:
    """When a run was begun, by its manifest; None where that does not read."""
    try:
        return msgspec.json.decode(manifest, type=_Begun).created
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def _plain_files(place: Path) -> Iterator[Path]:
    """Yield the files below a folder; files and folders without a plain name are skipped."""
    for folder, folders, files in os.walk(place):
        folders[:] = [name for name in folders if is_plain_path(name)]
        yield from (Path(folder, name) for name in files if is_plain_path(name))


def _stamp(path: Path) -> tuple[int, int]:
    found = path.lstat()
    return found.st_size, found.st_mtime_ns


def _table_hashes(manifest: bytes) -> dict[str, str]:
    """The hashes of the tables that a manifest names; none of one that does not read, which its readers refuse."""
    try:
        entries = msgspec.json.decode(manifest, type=Manifest).sequences.values()
    except (msgspec.DecodeError, UnicodeDecodeError):
        return {}
    return {name: digest for entry in entries for name, digest in entry.tables.items()}
