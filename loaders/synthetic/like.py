"""Write the root that a fingerprint describes: its folders, label files, keys, types, label names and frame numbers.

A fingerprint counts the values of each key in a folder. All values of a key are made together, in the order of people
and then of frames. Each type, name and further key gets a run of this order. So the counts are met, and a person keeps
a label for some time. Numbers are invented: people do not move.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.loaders.fingerprint import FRAME, Fingerprint, Folder, Kind, without_digits
from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.loaders.labelfiles.records import BROKEN
from jrdb_avr.loaders.root import CALIBRATION, IMAGE_DIRS
from jrdb_avr.loaders.synthetic.write import CALIBRATION_FILES
from jrdb_avr.schema.errors import InputError

_MOST_VALUES: Final = 6_000_000
"""Maximum number of JSON values. If a fingerprint has more than a third, only a share of the records is made."""
_INDEXED: Final = ("id", "label_id", "tracking_id", "floor_id", "cluster_ID", "frame_id", "cx")
"""Keys with the index of the record as number. A few other keys have other numbers, and the rest has 1."""
_SCALARS: Final[dict[str, Any]] = {"int": int, "float": float, "bool": lambda _: False, "NoneType": lambda _: None}

_Place = tuple[str, list[int], int | None]
"""Name and frames of the file of a value, and the index of its record in its frame or list, if any."""


def write_like(file: Path, root: Path) -> str:
    """Write a root with the keys, types, label names, layers and frame numbers of a fingerprint.

    Args:
        file: File that `load --fingerprint` has written.
        root: Empty folder.

    Returns:
        A line with the share of the described records that was written.

    Raises:
        InputError: If the file is not a fingerprint, or describes more or other files than a root can have.
        OSError: If a file cannot be written.
    """
    try:
        folders = msgspec.json.decode(to_utf8(read_input(file), file), type=Fingerprint).folders
        maker = _Maker(min(1.0, _MOST_VALUES / 3 / max(sum(folder.keys.total() for folder in folders.values()), 1)))
        for path, folder in folders.items():
            _write_folder(path, folder, maker, root)
    except BROKEN as error:
        raise InputError(f"{file} is not a file of 'load --fingerprint': {error}", file=str(file)) from None
    return f"{maker.share:.2%} of the records that {file} describes, all synthetic"


def _write_folder(path: str, folder: Folder, maker: _Maker, root: Path) -> None:
    """Write the files of a folder."""
    for part in (*path.split("/"), *folder.labels) if path != "." else folder.labels:
        if not part.strip(".") or "/" in part or not part.isprintable() or len(part.encode()) > 200:
            raise InputError(f"{part[:60]!r} in a fingerprint cannot be the name of a file or folder below a root")
    target = root / path
    target.mkdir(parents=True, exist_ok=True)
    if target.name == CALIBRATION:
        shutil.copytree(CALIBRATION_FILES, target, dirs_exist_ok=True)
    # Pictures are empty files, and only those that `load` reads.
    for frame in maker.frames(folder.frames if target.parent.name == Path(IMAGE_DIRS[0]).name else []):
        (target / f"{frame:06}{'.jpg' if '.jpg' in folder.files else '.png'}").touch()
    spans = {name: span for name, span in folder.labels.items() if span != "not JSON"}
    places: list[_Place] = [(Path(name).stem, maker.frames(span), None) for name, span in spans.items()]
    texts = map(msgspec.json.encode, maker.make(folder.keys, places, ""))
    for name in folder.labels:
        (target / name).write_bytes(next(texts) if name in spans else b"{")


class _Maker:
    """Maker of at most `_MOST_VALUES` values, and of a share of the records."""

    def __init__(self, share: float) -> None:
        self.share = share
        self._left = _MOST_VALUES

    def frames(self, span: Any) -> list[int]:
        """Return frames with the given first frame, last frame and count, at equal distances but for missing frames."""
        first, last, count = span if len(span) == 3 else (0, 0, 0)
        # To create a file takes as long as a few values.
        self._left -= 4 * (count + 1)
        if count > last - first + 1 or self._left < 0:
            raise InputError(f"{span} in a fingerprint is not first, last and number of frames, or has too many")
        frames = [*range(first, last, (last - first) // max(count - 1, 1) or 1), last]
        del frames[1 : 1 + len(frames) - count]
        return frames if count else []

    def make(self, kind: Kind, places: list[_Place], key: str) -> list[Any]:
        """Return the values of a key at the given places."""
        self._left -= len(places)
        if self._left < 0:
            raise InputError(f"the fingerprint describes more than {_MOST_VALUES:,} values beside its records")
        makers = {"dict": self._dicts, "list": self._lists, "str": _texts}
        made: list[Any] = []
        for name, count in _split(kind.types, len(places)):
            part = places[len(made) : len(made) + count]
            scalar = _SCALARS.get(name, float)
            made += makers[name](kind, part, key) if name in makers else [scalar(_number(key, place)) for place in part]
        return made + [None] * (len(places) - len(made))

    def _dicts(self, kind: Kind, places: list[_Place], _: str) -> list[Any]:
        dicts: list[dict[str, Any]] = [{} for _ in places]
        start, size = 0, len(dicts)
        for name, child in kind.keys.items() if dicts else ():
            count = min(sum(child.types.values()) * size // kind.types["dict"] or 1, self._left + 1)
            # A key begins at the object at which the key before has ended, so that all get about as many keys.
            slots = sorted(((start + j) % size, j // size) for j in range(count))
            start += count
            if FRAME.fullmatch(name) and any(frames for _, frames, _ in places):
                pairs = ((i, frame) for i, (_, frames, _) in enumerate(places) for frame in frames)
                slots = list(islice(pairs, self._left + 1))
            for (i, number), value in zip(slots, self.make(child, [places[i] for i, _ in slots], name), strict=True):
                dicts[i][_renumber(name, number)] = value
        return dicts

    def _lists(self, kind: Kind, places: list[_Place], key: str) -> list[Any]:
        lists: list[list[Any]] = [[] for _ in places]
        child = kind.keys.get("[]", Kind())
        share = self.share if FRAME.fullmatch(key) or key in ("annotations", "data") else 1
        total = min(int(sum(child.types.values()) * len(lists) / max(kind.types["list"], 1) * share), self._left + 1)
        # The first list has the smallest length, the last has the largest, and the others have about equal lengths.
        ends = [*kind.lengths] if kind.lengths and len(lists) > 1 and sum(kind.lengths) <= total else []
        rest, total = len(lists) - len(ends), total - sum(ends)
        lengths = ends[:1] + [(i + 1) * total // rest - i * total // rest for i in range(rest)] + ends[1:]
        if key == "images":
            lengths = [len(frames) if index is None else 0 for _, frames, index in places]
        slots = sorted((j, i) for i, length in enumerate(lengths) for j in range(length))
        inner = [(*places[i][:2], j if places[i][2] is None else places[i][2]) for j, i in slots]
        for (_, i), item in zip(slots, self.make(child, inner, key), strict=True):
            lists[i].append(item)
        for i, (_, _, index) in enumerate(places if key in ("box", "bbox") else ()):
            # All boxes of a person are at about the same column, and no two boxes of a folder are equal.
            box = (37 * (index or 0) % 3600, 50 + 2 * (i % 97), 40 + i // 4850 % 60, 60 + i // 97 % 50)
            pairs = zip(lists[i], box, strict=False)
            lists[i][:4] = [type(x)(n) if isinstance(x, int | float) else x for x, n in pairs]
        return lists


def _split(counts: dict[str, int], total: int) -> Iterator[tuple[str, int]]:
    """Divide a total in proportion to counts. Each gets at least 1 while any is left."""
    whole = sum(counts.values())
    for name, count in counts.items():
        share = min(max(count * total // max(whole, 1), int(count > 0)), total)
        yield name, share
        total, whole = total - share, whole - count


def _number(key: str, place: _Place) -> float:
    index, frames = place[2] or 0, len(place[1]) or 1
    numbers = {"image_id": index % frames, "track_id": index // frames, "timestamp": index / 15}
    return numbers.get(key, index if key in _INDEXED else 1)


def _texts(kind: Kind, places: list[_Place], key: str) -> list[str]:
    """Return names with the numbers of people or frames, or numbers if there are no names."""
    listed = kind.names or {}
    counts = listed | {"": kind.types["str"] - sum(listed.values())}
    names = [name for name, count in _split(counts, len(places)) for _ in range(count)]
    for i, (file, frames, index) in enumerate(places):
        # A person is no partner of itself. A name with too many digits begins with zeros, which `load` ignores.
        number = (index or 0) ^ (key == "pair")
        if key == "file_name" and frames:
            sequence, number = without_digits(file), frames[number % len(frames)]
            names[i] = next((name for name in listed if sequence in name), names[i]).replace(sequence, file)
        names[i] = _renumber(names[i], number) if names[i] else f"{_number(key, places[i]):.0f}"
    return names


def _renumber(text: str, number: int) -> str:
    """Replace the last digits of a text by the last digits of a number."""
    return re.sub(r"[0-9]+(?=\D*$)", lambda digits: f"{number:0{len(digits[0])}}"[-len(digits[0]) :], text)
