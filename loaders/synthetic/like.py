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
from typing import Any, Final, NamedTuple

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


class _Place(NamedTuple):
    """Place of a value: name and frames of its file, and the index of its record in its frame or list, if any."""

    file: str
    frames: list[int]
    item: int | None = None


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
    ending = next((ending for ending in folder.files if FRAME.fullmatch(f"0{ending}")), "")
    # Pictures are empty files, and only those that `load` reads.
    for frame in maker.frames(folder.frames if target.parent.name == Path(IMAGE_DIRS[0]).name else []):
        (target / f"{frame:06}{ending}").touch()
    places = {n: _Place(Path(n).stem, maker.frames(span)) for n, span in folder.labels.items() if span != "not JSON"}
    texts = map(msgspec.json.encode, maker.make(folder.keys, [*places.values()], ""))
    for name in folder.labels:
        (target / name).write_bytes(next(texts) if name in places else b"{")


class _Maker:
    """Maker of at most `_MOST_VALUES` values, and of a share of the records."""

    def __init__(self, share: float) -> None:
        self.share = share
        self._left = _MOST_VALUES

    def spend(self, values: int) -> None:
        """Raise InputError if no values are left."""
        self._left -= values
        if self._left < 0:
            raise InputError(f"the fingerprint describes more than {_MOST_VALUES:,} values beside its records")

    def frames(self, span: Any) -> list[int]:
        """Return frames with the given first frame, last frame and count, at equal distances but for missing frames."""
        first, last, count = span if len(span) == 3 else (0, 0, 0)
        # To create a file takes as long as a few values.
        self.spend(4 * (count + 1))
        if count > last - first + 1:
            raise InputError(f"{span} in a fingerprint is not first frame, last frame and number of frames")
        frames = [*range(first, last, (last - first) // max(count - 1, 1) or 1), last]
        del frames[1 : 1 + len(frames) - count]
        return frames if count else []

    def make(self, kind: Kind, places: list[_Place], key: str) -> list[Any]:
        """Return the values of a key at the given places."""
        self.spend(len(places))
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
            if FRAME.fullmatch(name) and any(place.frames for place in places):
                slots = list(islice(((i, n) for i, place in enumerate(places) for n in place.frames), self._left + 1))
            for (i, number), value in zip(slots, self.make(child, [places[i] for i, _ in slots], name), strict=True):
                dicts[i][_renumber(name, number)] = value
        return dicts

    def _lists(self, kind: Kind, places: list[_Place], key: str) -> list[Any]:
        lists: list[list[Any]] = [[] for _ in places]
        child = kind.keys.get("[]", Kind())
        share = self.share if FRAME.fullmatch(key) or key == "annotations" else 1
        total = min(int(sum(child.types.values()) * len(lists) / max(kind.types["list"], 1) * share), self._left + 1)
        lengths = _lengths(kind.lengths or (0, 0), len(lists), total)
        if key == "images":
            lengths = [len(place.frames) if place.item is None else 0 for place in places]
        slots = sorted((j, i) for i, length in enumerate(lengths) for j in range(length))
        inner = [places[i] if places[i].item is not None else _Place(*places[i][:2], j) for j, i in slots]
        for (_, i), item in zip(slots, self.make(child, inner, key), strict=True):
            lists[i].append(item)
        for i, place in enumerate(places if key in ("box", "bbox") else ()):
            # All boxes of a person are at about the same column, and no two boxes of a folder are equal.
            box = (37 * (place.item or 0) % 3600, 50 + 2 * (i % 97), 40 + i // 4850 % 60, 60 + i // 97 % 50)
            lists[i][:4] = [
                type(x)(n) if isinstance(x, int | float) else x for x, n in zip(lists[i], box, strict=False)
            ]
        return lists


def _split(counts: dict[str, int], total: int) -> Iterator[tuple[str, int]]:
    """Divide a total in proportion to counts. Each gets at least 1 while any is left."""
    whole = sum(counts.values())
    for name, count in counts.items():
        share = min(max(count * total // max(whole, 1), int(count > 0)), total)
        yield name, share
        total, whole = total - share, whole - count


def _lengths(bounds: tuple[int, int], count: int, total: int) -> list[int]:
    """Return lengths of lists that sum to a total: the largest, then about equal ones, then the smallest."""
    ends = [bounds[1], bounds[0]] if count > 1 and sum(bounds) <= total else []
    rest, total = count - len(ends), total - sum(ends)
    return ends[:1] + [(i + 1) * total // rest - i * total // rest for i in range(rest)] + ends[1:]


def _number(key: str, place: _Place) -> float:
    item, frames = place.item or 0, len(place.frames) or 1
    numbers = {"image_id": item % frames, "track_id": item // frames, "timestamp": item / 15}
    return numbers.get(key, item if key in _INDEXED else 1)


def _texts(kind: Kind, places: list[_Place], key: str) -> list[str]:
    """Return names with the numbers of people or frames, or numbers if there are no names."""
    unnamed = kind.types["str"] - sum(kind.names.values())
    names = [name for name, count in _split(kind.names | {"": unnamed}, len(places)) for _ in range(count)]
    for i, place in enumerate(places):
        # A person is no partner of itself. A name with too many digits begins with zeros, which `load` ignores.
        number = (place.item or 0) ^ (key == "pair")
        if key == "file_name" and place.frames:
            sequence, number = without_digits(place.file), place.frames[number % len(place.frames)]
            names[i] = next((name for name in kind.names if sequence in name), names[i]).replace(sequence, place.file)
        names[i] = _renumber(names[i], number) if names[i] else f"{_number(key, place):.0f}"
    return names


def _renumber(text: str, number: int) -> str:
    """Replace the last digits of a text by the last digits of a number."""
    return re.sub(r"[0-9]+(?=\D*$)", lambda digits: f"{number:0{len(digits[0])}}"[-len(digits[0]) :], text)
