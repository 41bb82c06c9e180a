"""Search for the label files of a JRDB root, by layer and by sequence.

The layout of a root depends on the release. Some releases have a folder `labels/`, and some name the folders of train
and test differently. The stitched 2D boxes are also in the social and the reasoning files. The folder of a layer is
chosen per sequence: if the first folder lacks the sequence, the next folder is used. Further folders of a root, such as
folders of single cameras, are ignored.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from jrdb_avr.loaders.problems import Problem, Problems, shorten
from jrdb_avr.queries.store import safe_sequence
from jrdb_avr.schema.errors import InputError

LABEL_DIRS: Final[dict[str, tuple[str, ...]]] = {
    "2d": ("labels_2d_stitched",),
    "3d": ("labels_3d",),
    "social": ("labels_2d_activity_social_stitched", "labels_2d_social"),
    "reasoning": ("labels_2d_stitched_new_version", "labels_2d_stitched_test_new_version1"),
    "pose": ("labels_2d_pose_stitched_coco", "pose_stitched"),
    "panoptic": ("labels_2d_panoptic_stitched_CW*", "labels_2d_panoptic_stitched_OW*"),
}
"""Names of the folders with files `<sequence>.json`, by layer, in order of preference.

A star stands for any suffix. A folder without a suffix is preferred.
"""

TIMESTAMPS: Final = "timestamps"
CALIBRATION: Final = "calibration"
LAYER_FILES: Final = (*LABEL_DIRS, TIMESTAMPS, CALIBRATION)
"""Layers that have files, in the order of reading. The 2D layer must be first, because it is the reference."""

BOXES_ELSEWHERE: Final = ("social", "reasoning")
"""Layers with files that repeat the 2D records. If a sequence has no 2D file, its boxes are read from these files."""

CAMERAS_FILE: Final = "cameras.yaml"
IMAGE_DIRS: Final = ("images/image_stitched", "image_stitched")

_IMAGE: Final = re.compile(r"([0-9]{6})\.jpg")
ONE_CAMERA: Final = re.compile(r".+_(?:image|camera_)[0-9]")
"""Names of label files of single cameras, which some releases keep in the same folder as the stitched files."""


@dataclass(frozen=True)
class SequenceFiles:
    """Paths of one sequence's label files and panoramas. Paths are strings, which can be sent to worker processes."""

    sequence: str
    labels: dict[str, str]
    """Path by layer. The path of `timestamps` is a folder. The path of `calibration` is a file for all sequences."""
    images: str | None
    """Folder of the panoramas, or None if the sequence has none."""


@dataclass(frozen=True)
class Root:
    """Files of a JRDB root, as `find_root` has found them."""

    path: Path
    image_root: str | None
    """Folder that has a folder of panoramas for each sequence, or None if the root has no panoramas."""
    sequences: tuple[SequenceFiles, ...]
    """Sequences, sorted by name."""
    problems: tuple[Problem, ...]
    """Problems of the search, such as unreadable folders and file names that cannot be sequence names."""
    notes: tuple[str, ...]
    """Notes about folders without label files."""


def find_root(path: str | Path, layer_dirs: Mapping[str, Sequence[str]] | None = None) -> Root:
    """Find the label files of a JRDB root.

    Args:
        path: folder of the root.
        layer_dirs: by layer, folders that replace the layer's usual folders. Relative paths start at the root. A layer
            with an empty list is not loaded.

    Returns:
        The sequences with their files, and the problems of the search.

    Raises:
        InputError: If the root or a given folder is missing, if the root has no label files, or if a layer is unknown.
    """
    root = Path(path)
    search = _Search(root)
    if not search.is_folder(root):
        raise InputError(f"{root} is not a folder: give the unpacked folder that holds labels/ or labels_2d_stitched/")
    chosen = {layer: search.chosen(layer, names) for layer, names in (layer_dirs or {}).items()}
    files: dict[str, dict[str, str]] = {}
    for layer in LABEL_DIRS:
        for folder in chosen[layer] if layer in chosen else search.usual(layer):
            for file in search.label_files(folder):
                sequence = search.sequence(file)
                if sequence is not None:
                    files.setdefault(sequence, {}).setdefault(layer, str(file))
    if not files and not search.problems:
        path, known = root.resolve(), [name for names in LABEL_DIRS.values() for name in names]
        if any(fnmatch.fnmatch(path.name, name) for name in known):
            raise InputError(f"{root} is the folder of one layer: give {path.parents[path.parent.name == 'labels']}")
        inner = {str(x.parents[1]) for name in known for up in ("*", "*/*") for x in root.glob(f"{up}/labels/{name}")}
        if inner:
            raise InputError(f"{root} holds nothing to load, but its folders do: give {' or '.join(sorted(inner))}")
        folders = ", ".join(names[0].removesuffix("*") for names in LABEL_DIRS.values())
        raise InputError(f"{root} holds nothing to load: no files SEQUENCE.json in {folders}, with or without labels/")
    images_in = next((name for name in IMAGE_DIRS if search.is_folder(root / name)), None)
    sequences = []
    for sequence in sorted(files):
        labels = files[sequence]
        if "2d" not in chosen:
            richer = next((labels[layer] for layer in BOXES_ELSEWHERE if layer in labels), None)
            if richer is not None:
                labels.setdefault("2d", richer)
        for layer in (TIMESTAMPS, CALIBRATION):
            name = sequence if layer == TIMESTAMPS else CAMERAS_FILE
            for folder in chosen[layer] if layer in chosen else (root / layer, root / "labels" / layer):
                if search.exists(folder / name):
                    labels.setdefault(layer, str(folder / name))
        images = root / images_in / sequence if images_in else None
        sequences.append(SequenceFiles(sequence, labels, str(images) if images and search.is_folder(images) else None))
    image_root = None if images_in is None else str((root / images_in).resolve())
    return Root(root, image_root, tuple(sequences), tuple(search.problems), tuple(search.notes))


class _Search:
    """Search through the folders of a root. The search collects problems and notes for the load report."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.problems: list[Problem] = []
        self.notes: list[str] = []
        self._names = {base: self._listing(base) or frozenset() for base in (root / "labels", root)}

    def chosen(self, layer: str, names: Sequence[str]) -> list[Path]:
        """Return the paths of the folders that the user gave for a layer.

        Raise InputError if the layer is unknown or a folder is missing.
        """
        if layer not in LAYER_FILES:
            raise InputError(f"there is no layer {layer}: choose from {', '.join(LAYER_FILES)}")
        folders = [self.root / name for name in names]
        for folder in folders:
            if not self.is_folder(folder):
                raise InputError(f"{folder}, given for the layer {layer}, is not a folder")
        return folders

    def usual(self, layer: str) -> list[Path]:
        """Return the existing folders of a layer under their usual names, in order of preference."""
        folders = []
        for name in LABEL_DIRS[layer]:
            fits = {entry for entries in self._names.values() for entry in fnmatch.filter(entries, name)}
            folders += [base / entry for entry in sorted(fits) for base in self._names if entry in self._names[base]]
        return folders

    def label_files(self, folder: Path) -> list[Path]:
        """Return the stitched label files (.json or .JSON) in a folder: one per sequence, sorted by name."""
        entries = self._listing(folder)
        if entries is None:
            return []
        named = [name for name in entries if name.lower().endswith(".json") and not ONE_CAMERA.fullmatch(name[:-5])]
        if not named:
            self.notes.append(f"{self._shown(folder)} holds no label files of sequences")
        # X.json is preferred to X.JSON, so it is sorted first.
        names: dict[str, str] = {}
        for name in sorted(named, key=lambda name: (name[:-5], not name.endswith(".json"), name)):
            if names.setdefault(name[:-5], name) != name:
                self._refuse(name, f"in {self._shown(folder)}: {names[name[:-5]]} is the same sequence")
        return [folder / name for name in names.values()]

    def sequence(self, file: Path) -> str | None:
        """Return the name of a label file's sequence.

        If the file name cannot be a sequence name, refuse the file and return None.
        """
        try:
            return safe_sequence(file.stem)
        except InputError:
            self._refuse(file.name, f"in {self._shown(file.parent)}: file name cannot be a sequence name")
            return None

    def is_folder(self, path: Path) -> bool:
        """Return whether `path` is a folder. If the path cannot be examined, report the path and return False."""
        try:
            return path.is_dir()
        except OSError as error:
            self._refuse(self._shown(path), f"folder cannot be read: {error.strerror}")
            return False

    def exists(self, path: Path) -> bool:
        """Return whether `path` exists. A dangling link, and a path that cannot be examined, count as existing."""
        try:
            path.lstat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            pass
        return True

    def _listing(self, folder: Path) -> frozenset[str] | None:
        """Return the names in a folder, or None if the folder exists but cannot be read.

        A missing folder has no names. An unreadable folder is reported.
        """
        try:
            with os.scandir(folder) as entries:
                return frozenset(entry.name for entry in entries)
        except FileNotFoundError:
            return frozenset()
        except OSError as error:
            self._refuse(self._shown(folder), f"folder cannot be read: {error.strerror}")
            return None

    def _refuse(self, name: str, reason: str) -> None:
        problems = Problems(name)
        problems.add("file", reason)
        self.problems += problems.listed()

    def _shown(self, folder: Path) -> str:
        return shorten(str(folder.relative_to(self.root)) if folder.is_relative_to(self.root) else str(folder), 200)


def total_size(paths: Iterable[str | Path]) -> int:
    """Return the total size of files in bytes. Larger sequences are processed first.

    Args:
        paths: files. Files that cannot be examined count as empty.
    """
    size = 0
    for path in paths:
        with contextlib.suppress(OSError):
            size += Path(path).stat().st_size
    return size


def image_frames(folder: str | None) -> list[int]:
    """Return the frames that have a panorama (`000000.jpg`, ...) in a folder, ascending.

    Args:
        folder: folder of the panoramas of a sequence, or None for no frames.

    Raises:
        InputError: If the folder cannot be read.
    """
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
    except OSError:  # The entry is a circular link.
        return False
