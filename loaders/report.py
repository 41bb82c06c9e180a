"""Records of the load report: what was loaded and what was refused in each sequence."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.problems import Problem

MIN_MOVES: Final = 100
"""Minimum number of displacements for a warning about headings."""
MAX_TURN_DEG: Final = 90.0
"""Maximum median angle between heading and displacement without a warning, in degrees."""


class UnknownLabel(msgspec.Struct):
    """Label that is outside the vocabulary, and the number of its occurrences.

    The label is spelled as in the tables.
    """

    field: str
    label: str
    count: int


class Heading(msgspec.Struct):
    """Result of the check that people faster than 0.5 m/s face their direction of motion."""

    moves: int
    """Number of compared displacements. Each displacement is over one second."""
    median_deg: float | None
    """Median angle between heading and displacement in degrees, or None if there are no displacements.

    The angle is near 0 if the convention holds, and near 180 if the file has the opposite convention."""


class FrameRange(msgspec.Struct, omit_defaults=True):
    """Range of the frames that have labels, or of the frames that have images.

    Frames inside the range may be missing.
    """

    first: int
    last: int
    count: int
    records: int = 0
    """Number of records in these frames, for a range of one layer."""


class ShiftCheck(msgspec.Struct):
    """Result of the check whether a layer numbers its frames like the 2D layer."""

    layer: str
    result: str
    """`agrees`, `shifted` (the layer is refused), or `not tested` (the evidence is too weak to decide)."""
    reason: str
    frames: float | None = None
    """Shift in frames that makes the layer fit the 2D layer, or None if it could not be estimated."""
    error: float | None = None
    """Standard error of the shift in frames, or None if it could not be estimated."""


class Stamps(msgspec.Struct):
    """Summary of the timestamps of a sequence."""

    images: int
    """Number of stamps of images."""
    clouds: int
    """Number of stamps of point clouds."""
    fps: float | None
    """Median frames per second of the images, or None for fewer than two stamps."""


class Cameras(msgspec.Struct):
    """Comparison of the cameras of a root with the constants for rows of the panorama. All lengths are in pixels."""

    cameras: int
    """Number of cameras."""
    fy: float
    """Median vertical focal length of the cameras."""
    focal_rows: float
    """Constant to compare with `fy`."""
    cy: float
    """Median row of the optical centre of the cameras."""
    horizon_row: float
    """Constant to compare with `cy`."""
    agrees: bool


class Disagreement(msgspec.Struct):
    """Attribute of a person or of a group that does not have the same value everywhere.

    The values differ between the frames of the person, or between the records of the group's members.
    """

    subject: str
    """Person or group, such as `person 12` or `group 7`."""
    attribute: str
    votes: dict[str, int]
    """Number of frames or records with each value. The keys are the values."""
    stated: int
    """Number of frames or records that state a value of the attribute."""


class SequenceReport(msgspec.Struct):
    """Report of one sequence. A report without a sequence describes the root as a whole."""

    sequence: str
    """Name of the sequence, or "" for the root as a whole."""
    problems: list[Problem]
    layers: list[str] = []
    """Layers that the table `frames` lists. The list is empty if the sequence could not be loaded."""
    steps: dict[str, int] = {}
    """By layer of labels, the distance between annotated frames.

    The distance is 1 if every frame is annotated, and 15 if one frame per second is annotated."""
    ranges: dict[str, FrameRange] = {}
    """By layer, its frames and its number of records."""
    occlusions: dict[str, int] = {}
    """By degree of occlusion, the number of 2D boxes."""
    odd_values: dict[str, list[str]] = {}
    """By layer, keys that its file lacks, and types of values, unlike the releases."""
    files: dict[str, str] = {}
    """By layer, the name of the file with the folder before it."""
    frames: int = 0
    """Number of frames that are in at least one layer."""
    people: int = 0
    boxes: int = 0
    """Number of 2D boxes of people."""
    boxes_3d: int = 0
    """Number of 3D boxes of people."""
    visibility: str = ""
    """Evidence for clear views: attributes, geometry (nearer boxes and group labels) or nothing."""
    unknown_labels: list[UnknownLabel] = []
    heading: Heading | None = None
    label_frames: FrameRange | None = None
    image_frames: FrameRange | None = None
    shifts: list[ShiftCheck] = []
    stamps: Stamps | None = None
    cameras: Cameras | None = None
    disagreements: list[Disagreement] = []
    """Demographics that differ between frames of a person, and group information that differs between members."""
    absent_partners: int = 0
    """Number of interactions that give no fact, because one of the two people has no 2D box in the frame."""
    warnings: list[str] = []
    """Warnings for the user to check. A warning refuses no data."""

    @property
    def refused(self) -> int:
        """Number of refused or skipped files, frames, records and fields."""
        return sum(problem.count for problem in self.problems)


def frame_range(frames: npt.NDArray[np.int64], records: int = 0) -> FrameRange | None:
    """Return the range of the ascending `frames`, or None if there are no frames."""
    return FrameRange(int(frames[0]), int(frames[-1]), len(frames), records) if len(frames) else None


def sequence_warnings(
    labels: FrameRange | None, images: FrameRange | None, heading: Heading | None, cameras: Cameras | None
) -> list[str]:
    """Return one line of warning for each check of a sequence that has found a fault."""
    lines = []
    if labels and images and (labels.first, labels.last) != (images.first, images.last):
        lines.append(
            f"labels span frames {labels.first}-{labels.last}, images {images.first}-{images.last}: in some copies of "
            "the train sequences, labels and images are off by 2 frames, and no file says so. Compare both with "
            "observe --panorama --boxes"
        )
    if heading and heading.moves >= MIN_MOVES and heading.median_deg is not None and heading.median_deg > MAX_TURN_DEG:
        lines.append(
            f"the headings of moving people are {heading.median_deg:.0f} degrees off their direction of motion: the "
            "rotations of the 3D boxes may have another sign or zero direction than in JRDB"
        )
    if cameras and not cameras.agrees:
        lines.append(
            f"the cameras' medians fy {cameras.fy:.1f} and cy {cameras.cy:.1f} differ from {cameras.focal_rows} and "
            f"{cameras.horizon_row}, the constants for rows of the panorama: are these the cameras of another robot?"
        )
    return lines


def totals(reports: list[SequenceReport]) -> str:
    """Return one line with the numbers of sequences, frames, people, boxes, unknown labels, refused parts and notes."""
    loaded = [report for report in reports if report.layers]
    sums = {name: sum(getattr(report, name) for report in loaded) for name in ("frames", "people", "boxes", "boxes_3d")}
    unknown = len({(label.field, label.label) for report in loaded for label in report.unknown_labels})
    notes = sum(len(report.warnings) for report in reports)
    sequences = "1 sequence" if len(loaded) == 1 else f"{len(loaded)} sequences"
    return (
        f"{sequences}, {sums['frames']:,} frames, {sums['people']:,} people, {sums['boxes']:,} boxes, "
        f"{sums['boxes_3d']:,} 3D boxes; {unknown} labels outside the vocabulary; "
        f"{sum(report.refused for report in reports):,} refused or skipped{f'; notes: {notes}, above' if notes else ''}"
    )
