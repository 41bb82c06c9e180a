"""Comparison of a loaded copy of JRDB with what is public about its releases."""

from __future__ import annotations

import contextlib
import csv
import fnmatch
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from jrdb_avr.loaders.fingerprint import Kind
from jrdb_avr.loaders.labelfiles.frames import MAX_FRAME, LabelFile, decode_file
from jrdb_avr.loaders.report import MAX_TURN_DEG, SequenceReport
from jrdb_avr.loaders.root import LABEL_DIRS
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import KEYFRAME_STEP
from jrdb_avr.schema.tables import LAYERS


class _Public(NamedTuple):
    """Split, number of frames, and numbers of tracks and boxes at the keyframes of a sequence."""

    split: str
    frames: int
    tracks: int
    boxes: int


_LINES: Final = files(__package__).joinpath("sequences.csv").read_text("utf-8").splitlines()[1:]
PUBLIC: Final = {name: _Public(split, *map(int, numbers)) for name, split, *numbers in csv.reader(_LINES)}
"""What is public of each sequence. Frames are of the release of 2022."""
_SPLIT: Final = 27
_RECORDS: Final = {("test", "2d"): 956_803, ("train", "interactions"): 1_452_876}
"""Public number of records of a layer in a whole split."""
_OCCLUSIONS: Final = {"Fully_visible": 0.292, "Mostly_visible": 0.145, "Severely_occluded": 0.312}
"""Public shares of boxes of the test split. The remaining boxes are fully occluded."""
_LEAST: Final = 0.9
"""Minimum share of the public number of boxes or records that is not called fewer."""
_MOST_SHARE: Final = 0.05
"""Maximum difference from a public share of boxes that is not called another share."""
_FROM_2019: Final = 2
"""First frame of train in the release of 2019. The release of 2022 numbers frames from 0."""

_VALUES: Final = {
    "2d": {"label_id": "str", "box.[]": "int float", "attributes.occlusion": "str", "action_label.*": "int"}
    | {"social_group.cluster_ID": "int"},
    "3d": {"label_id": "str", "box.cx": "float int", "box.rot_z": "float int"},
    "social": {"demographics_info.[].*.*": "str", "H-interaction.[].inter_labels.*": "str"}
    | {"group_info.[].venue.*": "str"},
}
"""Usual types of values, by key. A star is any key."""


def odd_values(layer: str, path: str | Path) -> Iterator[str]:
    """Compare keys and types of a label file with the releases, in about 20 frames.

    Args:
        layer: Layer of the file.
        path: Label file.

    Yields:
        A line per missing key, and per key with values mostly of another type. No line for an unreadable file.
    """
    kind = Kind()
    with contextlib.suppress(InputError, msgspec.DecodeError, RecursionError):
        frames = decode_file(Path(path), LabelFile, lambda form, key: form(key)).labels if layer in _VALUES else {}
        for frame in list(frames.values())[:: len(frames) // 20 + 1]:
            if memoryview(frame).nbytes <= MAX_FRAME:
                kind.add(msgspec.json.decode(frame))
    for key, usual in _VALUES.get(layer, {}).items() if "[]" in kind.keys else ():
        parts = [kind.keys["[]"]]
        for name in key.split("."):
            parts = [child for part in parts for n, child in part.keys.items() if name in (n, "*")]
        types, shown = sum((Counter(x.types) for x in parts), Counter()), key.partition(".[]")[0].removesuffix(".*")
        if not types:
            yield f"no {shown}"
        elif types.most_common(1)[0][0] not in usual.split():
            yield f"{types.most_common(1)[0][0]} in {shown}"


def compare_releases(reports: Sequence[SequenceReport]) -> list[dict[str, Any]]:
    """Compare each layer of a load with the public releases.

    Args:
        reports: Reports of a load.

    Returns:
        A row per layer: sequences per split, with the release that numbers frames in the same way; records; splits
        with the layer in all 27 sequences; and what no release has, with numbers of sequences if not in all. No row if
        no sequence is of JRDB.
    """
    loaded = [report for report in reports if report.layers]
    if not any(report.sequence in PUBLIC for report in loaded):
        return []
    rows = []
    for layer in LAYERS:
        having = [report for report in loaded if layer in report.layers]
        public = [report for report in having if report.sequence in PUBLIC]
        splits = Counter(PUBLIC[report.sequence].split for report in public)
        complete = [split for split, count in splits.items() if count == _SPLIT]
        years = " and ".join(sorted({_release(report, layer) for report in public} - {""}))
        odd = Counter(line for report in having for line in _differences(report, layer))
        unlike = [line + f" ({count})" * (count < len(having)) for line, count in odd.items()]
        for split in complete:
            unlike += _split_differences([r for r in public if PUBLIC[r.sequence].split == split], split, layer)
        found = [f"{n} {split}" + f" ({years})" * (split == "train" and bool(years)) for split, n in splits.items()]
        row = {"layer": layer, "found": ", ".join(found) or ("other" if having else "nothing")}
        row["records"] = f"{sum(report.ranges[layer].records for report in having):,}"
        rows.append(row | {"complete": ", ".join(complete) or "no", "unlike": "; ".join(unlike)})
    return rows


def _release(report: SequenceReport, layer: str) -> str:
    """Return the release that numbers the frames of a train sequence in the same way, or an empty text."""
    frames, public = report.ranges[layer], PUBLIC[report.sequence]
    if public.split == "test" or layer not in ("2d", "3d"):
        return ""
    if frames.last >= public.frames or (frames.first == _FROM_2019 and report.steps[layer] == 1):
        return "2019"
    return "2022" if frames.first == 0 else ""


def _differences(report: SequenceReport, layer: str) -> Iterator[str]:
    """Yield what no release has in a sequence."""
    frames, step = report.ranges[layer], report.steps.get(layer, 1)
    file = "social" if layer == "demographics" else layer
    folder = report.files.get(file, "").partition("/")[0]
    if file in LABEL_DIRS and not any(fnmatch.fnmatch(folder, name) for names in LABEL_DIRS.values() for name in names):
        yield f"folder {folder}"
    yield from report.odd_values.get(file, ())
    turn = report.heading.median_deg if report.heading else None
    if layer == "3d" and turn is not None and turn > MAX_TURN_DEG:
        yield "reversed headings"
    if layer in ("2d", "3d", "pose", "panoptic") and step != (KEYFRAME_STEP if layer == "panoptic" else 1):
        yield "keyframes only" if step > 1 else "more than keyframes"
    if layer == "2d" and (frames.last - frames.first) // step + 1 > frames.count:
        yield "missing frames"
    if report.sequence not in PUBLIC:
        yield "another sequence"
        return
    public = PUBLIC[report.sequence]
    if layer in ("2d", "images") and frames.last > public.frames + 1:
        yield "more frames"
    if layer == "2d":
        # Keyframes without people may be missing at both ends.
        if frames.last - frames.first < public.frames - 2 * step - 1:
            yield "fewer frames"
        if report.people < public.tracks:
            yield "fewer tracks"
        if frames.records < public.boxes * _LEAST * KEYFRAME_STEP / step:
            yield "fewer boxes"


def _split_differences(reports: list[SequenceReport], split: str, layer: str) -> Iterator[str]:
    """Yield what a whole split of no release has."""
    public = _RECORDS.get((split, layer), 0)
    if sum(report.ranges[layer].records for report in reports) < _LEAST * public:
        yield f"fewer records than {public:,}"
    if (split, layer) == ("test", "2d"):
        counts = sum((Counter(report.occlusions) for report in reports), Counter[str]())
        if any(abs(counts[name] / max(counts.total(), 1) - share) > _MOST_SHARE for name, share in _OCCLUSIONS.items()):
            yield "other shares of occlusion"
