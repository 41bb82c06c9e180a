"""Description of the files of a JRDB root without any annotation, which the owner of a copy may publish.

It has folders, file sizes, keys with the types of their values, lengths of lists, label names with counts, and the
numbers of frames. It has no value of a number, and in all names each digit is 0.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.loaders.root import LABEL_DIRS, ONE_CAMERA
from jrdb_avr.schema.errors import InputError

_FRAME: Final = re.compile(r"([0-9]+)\.(jpg|pcd|png|bin)")
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


class Kind:
    """Merged description of all values under one key."""

    def __init__(self) -> None:
        self.types: Counter[str] = Counter()
        self.names: Counter[str] = Counter()
        self.lengths: set[int] = set()
        self.keys: dict[str, Kind] = {}

    def add(self, value: Any, key: str = "") -> None:
        """Add a decoded JSON value."""
        self.types[type(value).__name__] += 1
        if isinstance(value, dict):
            for name, part in value.items():
                self.keys.setdefault(_without_digits(name), Kind()).add(part, name)
        elif isinstance(value, list):
            self.lengths.add(len(value))
            for part in value:
                self.keys.setdefault("[]", Kind()).add(part, key)
        elif isinstance(value, str) and key not in _MASKS and _NAME.fullmatch(value):
            self.names[_without_digits(value)] += 1

    def describe(self) -> dict[str, Any]:
        """Return the description as JSON values."""
        parts: dict[str, Any] = {"types": dict(sorted(self.types.items()))}
        if self.names and len(self.names) <= _MOST_NAMES:
            parts["names"] = dict(sorted(self.names.items()))
        if self.lengths:
            parts["lengths"] = [min(self.lengths), max(self.lengths)]
        return parts | {name: kind.describe() for name, kind in sorted(self.keys.items())}


def _without_digits(text: str) -> str:
    return re.sub(r"[0-9]", "0", text)[:60]


def fingerprint(root: str | Path) -> dict[str, Any]:
    """Describe the files of a JRDB root.

    Args:
        root: Folder of the root.

    Returns:
        A description of each folder, by its path below the root: number and sizes of files by ending, first and last
        frame and number of frames of pictures and of label files, and the merged keys of label files.

    Raises:
        InputError: If the root is missing.
        OSError: If a file cannot be read.
    """
    if not Path(root).is_dir():
        raise InputError(f"{root} is not a folder: give the folder that holds labels/ or labels_2d_stitched/")
    folders: dict[str, Any] = {}
    for path, _, names in sorted(os.walk(root)):
        folder, kind, sizes = Path(path), Kind(), dict[str, list[int]]()
        entry: dict[str, Any] = {"frames": _numbering(names), "labels": {}}
        for name in sorted(names):
            file = folder / name
            sizes.setdefault(file.suffix, []).append(file.stat().st_size)
            if file.suffix.lower() == ".json":
                try:
                    content = msgspec.json.decode(file.read_bytes())
                except (msgspec.DecodeError, RecursionError):
                    entry["labels"][name] = "not JSON"
                    continue
                kind.add(content)
                labels = content.get("labels") if isinstance(content, dict) else None
                entry["labels"][name] = _numbering(labels if isinstance(labels, dict) else ())
        entry["files"] = {end: {"count": len(own), "bytes": [min(own), max(own)]} for end, own in sorted(sizes.items())}
        if names:
            folders[folder.relative_to(root).as_posix()] = entry | {"keys": kind.describe()}
    return {"format": 1, "folders": folders}


def _numbering(names: Any) -> list[int]:
    """Return the first frame, the last frame and the number of frames of names such as `000000.jpg`, or nothing."""
    frames = sorted(int(match[1]) for name in names if (match := _FRAME.fullmatch(name)))
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
