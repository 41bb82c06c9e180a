"""Description of the files of a JRDB root without any annotation, which the owner of a copy may publish.

It has folders, file sizes, keys with the types of their values, lengths of lists, label names with counts, and the
numbers of frames. It has no value of a number, and in all names each digit is 0.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import re
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec

from jrdb_avr.loaders.root import LABEL_DIRS, ONE_CAMERA
from jrdb_avr.schema.errors import InputError

FRAME: Final = re.compile(r"(?:.*/)?([0-9]{1,9})(\.(?:jpg|pcd|png|bin))")
_NAME: Final = re.compile(r"[A-Za-z][\w /:.-]{0,59}")
"""Pattern of a label name. Codes of masks and other texts are counted, but not written."""
_MASKS: Final = {"segmentation", "counts"}
_MOST_NAMES: Final = 200
"""Maximum number of distinct names of a key."""

_KEYS: Final = {
    **{"3d": b'"cx"', "pose": b'"keypoints"', "panoptic": b'"segmentation"', "reasoning": b'"HOI"'},
    **{"social": b'"demographics_info"', "2d": b'"box"'},
}
"""Key that the files of each layer have. A file may have keys of later layers, too."""


_Count = Annotated[int, msgspec.Meta(ge=0, le=10**15)]
_Name = Annotated[str, msgspec.Meta(max_length=60)]
_Numbering = Annotated[list[Annotated[int, msgspec.Meta(ge=0, lt=10**9)]], msgspec.Meta(max_length=3)]


class Kind(msgspec.Struct, omit_defaults=True):
    """Merged description of all values under one key."""

    types: dict[_Name, _Count] = {}
    names: dict[_Name, _Count] | None = {}
    """Numbers of texts by name, or None if there are too many names to be labels."""
    lengths: tuple[_Count, _Count] | None = None
    """Smallest and largest length of the lists."""
    keys: dict[_Name, Kind] = {}
    """Descriptions by key of the objects. The key of items of lists is `[]`."""

    def add(self, value: Any, key: str = "") -> None:
        """Add a decoded JSON value."""
        name = type(value).__name__
        self.types[name] = self.types.get(name, 0) + 1
        if isinstance(value, dict):
            for name, part in value.items():
                self.keys.setdefault(without_digits(name), Kind()).add(part, name)
        elif isinstance(value, list):
            lengths = *(self.lengths or ()), len(value)
            self.lengths = min(lengths), max(lengths)
            for part in value:
                self.keys.setdefault("[]", Kind()).add(part, key)
        elif isinstance(value, str) and self.names is not None and key not in _MASKS and _NAME.fullmatch(value):
            self.names[without_digits(value)] = self.names.get(without_digits(value), 0) + 1
            self.names = self.names if len(self.names) <= _MOST_NAMES else None

    def total(self) -> int:
        """Return the number of described values."""
        return sum(self.types.values()) + sum(kind.total() for kind in self.keys.values())


class Folder(msgspec.Struct):
    """Description of the files of a folder."""

    frames: _Numbering
    """First frame, last frame and number of frames of pictures, or nothing."""
    labels: dict[str, _Numbering | Literal["not JSON"]] = {}
    """The same of each label file."""
    files: dict[str, Any] = {}
    """Number and sizes of files by ending."""
    keys: Kind = msgspec.field(default_factory=Kind)
    """Merged description of all label files."""


class Fingerprint(msgspec.Struct, tag_field="format", tag=2):
    """Description of each folder with files, by its path below the root."""

    folders: dict[Annotated[str, msgspec.Meta(max_length=1000)], Folder]


def without_digits(text: str) -> str:
    """Return the first 60 characters of a text, with 0 for each digit."""
    return re.sub(r"[0-9]", "0", text)[:60]


def fingerprint(root: str | Path) -> Fingerprint:
    """Describe the files of a JRDB root.

    Args:
        root: Folder of the root.

    Returns:
        A description of each folder: number and sizes of files by ending, first and last frame and number of frames of
        pictures and of label files, and the merged keys of label files.

    Raises:
        InputError: If the root is missing.
        OSError: If a file cannot be read.
    """
    if not Path(root).is_dir():
        raise InputError(f"{root} is not a folder: give the folder that holds labels/ or labels_2d_stitched/")
    folders: dict[str, Folder] = {}
    for path, _, names in sorted(os.walk(root)):
        folder, sizes = Folder(_numbering(names)), dict[str, list[int]]()
        for name in sorted(names):
            file = Path(path, name)
            sizes.setdefault(file.suffix, []).append(file.stat().st_size)
            if file.suffix.lower() == ".json":
                try:
                    content = msgspec.json.decode(file.read_bytes())
                except (msgspec.DecodeError, RecursionError):
                    folder.labels[name] = "not JSON"
                    continue
                folder.keys.add(content)
                frames = content.get("labels", content.get("images")) if isinstance(content, dict) else ()
                folder.labels[name] = _numbering(frames if isinstance(frames, dict | list) else ())
        folder.files = {end: {"count": len(own), "bytes": [min(own), max(own)]} for end, own in sizes.items()}
        if names:
            folders[Path(path).relative_to(root).as_posix()] = folder
    return Fingerprint(folders)


def _numbering(names: Iterable[Any]) -> list[int]:
    """Return first frame, last frame and number of frames of file names, keys of `labels` or images, or nothing."""
    texts = (str(name.get("file_name") if isinstance(name, dict) else name) for name in names)
    frames = sorted(int(match[1]) for text in texts if (match := FRAME.fullmatch(text)))
    return [frames[0], frames[-1], len(frames)] if frames else []


def renamed_folders(root: Path, chosen: Collection[Path]) -> list[str]:
    """Find archives, and folders that `load` does not know, but that have label files of a layer.

    Args:
        root: Folder of the root.
        chosen: Folders that the user gave for layers.

    Returns:
        A line per archive or folder: how to load it, or what it lacks.
    """
    known = [pattern for patterns in LABEL_DIRS.values() for pattern in patterns]
    archives = [x for x in sorted({*root.glob("*.zip"), *root.glob("labels/*.zip")}) if not x.with_suffix("").exists()]
    lines = [f"{path.relative_to(root)} is an archive: if it is not unpacked, unpack it" for path in archives]
    for folder in sorted({*root.glob("*/"), *root.glob("*/*/"), *root.glob("labels/*/*/")} - set(chosen)):
        name = folder.relative_to(root).as_posix()
        files = sorted(folder.glob("*.json"))
        stitched = [file for file in files if not ONE_CAMERA.fullmatch(file.stem)]
        usual = folder.parent in (root, root / "labels") and any(fnmatch.fnmatch(folder.name, n) for n in known)
        if not files or "head" in folder.name or (usual and stitched):
            continue
        with contextlib.suppress(OSError), (stitched or files)[0].open("rb") as file:
            start = file.read(1 << 16)
            layer = next((layer for layer, key in _KEYS.items() if key in start), None)
            if layer and stitched:
                lines.append(f"{name} looks like the layer {layer}: to load it, add --layer-dir {layer}={name}")
            elif layer == "2d" and (usual or not (folder.parent / "labels_2d_stitched").exists()):
                lines.append(f"{name} has files of single cameras only: add the files labels_2d_stitched/SEQUENCE.json")
    return lines
