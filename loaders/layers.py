"""Where a JRDB root keeps the layers, and which sequences it has.

Releases differ: with or without a `labels/` level, and the stitched 2D boxes come also inside the richer label files.
The first directory that holds label files is taken for a layer.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from jrdb_avr.queries.store import safe_sequence
from jrdb_avr.schema.errors import InputError

LABEL_DIRS: Final[dict[str, tuple[str, ...]]] = {
    "2d": (
        "labels_2d_stitched",
        "labels_2d_activity_social_stitched",
        "labels_2d_social",
        "labels_2d_stitched_new_version",
        "labels_2d_stitched_test_new_version1",
    ),
    "3d": ("labels_3d",),
}
"""Directory names per layer; the later 2D ones hold the same boxes among more."""

IMAGE_DIRS: Final = ("images/image_stitched", "image_stitched")

_IMAGE: Final = re.compile(r"([0-9]{6})\.jpg")


@dataclass(frozen=True)
class SequenceFiles:
    """The label files of one sequence by layer, and its folder of panoramas. Plain paths, so that workers get them."""

    sequence: str
    labels: dict[str, str]
    images: str | None

    @property
    def weight(self) -> int:
        """Bytes of label files; unreadable ones count nothing."""
        sizes = 0
        for path in self.labels.values():
            try:
                sizes += Path(path).stat().st_size
            except OSError:
                continue
        return sizes


@dataclass(frozen=True)
class Root:
    """What a JRDB root holds."""

    path: Path
    image_root: Path | None
    sequences: tuple[SequenceFiles, ...]
    """By name."""
    unnamable: tuple[Path, ...]
    """Label files whose names cannot be sequence names."""


def find_root(path: str | Path) -> Root:
    """Look through a JRDB root. Raises InputError where it is missing or holds no label files."""
    root = Path(path)
    if not root.is_dir():
        raise InputError(f"{root} is not a folder: give the folder that holds labels/ or labels_2d_stitched/")
    files: dict[str, dict[str, str]] = {}
    unnamable = []
    for layer, names in LABEL_DIRS.items():
        for file in _label_files(root, names):
            try:
                files.setdefault(safe_sequence(file.stem), {})[layer] = str(file)
            except InputError:
                unnamable.append(file)
    if not files and not unnamable:
        wanted = ", ".join(LABEL_DIRS[layer][0] for layer in LABEL_DIRS)
        raise InputError(f"{root} holds nothing to load: no .json files in {wanted}, with or without labels/")
    image_root = next((root / name for name in IMAGE_DIRS if (root / name).is_dir()), None)
    sequences = []
    for sequence in sorted(files):
        folder = image_root / sequence if image_root else None
        sequences.append(SequenceFiles(sequence, files[sequence], str(folder) if folder and folder.is_dir() else None))
    return Root(root, image_root, tuple(sequences), tuple(sorted(unnamable)))


def image_frames(folder: str | None) -> list[int]:
    """Frame numbers of the panoramas `000000.jpg`, ... in a folder, ascending. Raises InputError if unreadable."""
    if folder is None:
        return []
    try:
        with os.scandir(folder) as entries:
            named = [(_IMAGE.fullmatch(entry.name), entry) for entry in entries]
            return sorted(int(match[1]) for match, entry in named if match and _is_file(entry))
    except OSError as error:
        name = Path(folder).name
        raise InputError(f"{name}: the folder of images cannot be read: {error.strerror}", file=name) from None


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_file()
    except OSError:  # a link that leads round in a circle
        return False


def _label_files(root: Path, names: tuple[str, ...]) -> list[Path]:
    for name in names:
        for folder in (root / "labels" / name, root / name):
            try:
                found = sorted(file for file in folder.iterdir() if file.suffix == ".json")
            except OSError:
                continue
            if found:
                return found
    return []
