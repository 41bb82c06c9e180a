"""The load report: loaded and refused parts per sequence."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.problems import Problem

MIN_MOVES: Final = 100
MAX_TURN_DEG: Final = 90.0
"""Maximum plausible median angle between heading and displacement. A moving robot blurs the angle."""


class UnknownLabel(msgspec.Struct):
    """A label outside the vocabulary, in its normal spelling."""

    field: str
    label: str
    count: int


class Heading(msgspec.Struct):
    """Self-check of the heading convention: people faster than 0.5 m/s should face their direction of motion."""

    moves: int
    """Number of displacements over one second."""
    median_deg: float | None
    """Median angle between heading and displacement: near 0 if the convention holds, near 180 if it is reversed."""


class FrameRange(msgspec.Struct):
    """First, last and number of present frames."""

    first: int
    last: int
    count: int


class ShiftCheck(msgspec.Struct):
    """Comparison of the frame numbers of a layer with the 2D boxes, by the people in both."""

    layer: str
    result: str
    """`agrees`; `shifted`: the layer is refused; `not tested`: there is no evidence either way."""
    reason: str
    frames: float | None = None
    """Shift in frames at which the layer fits the 2D layer, estimated from moving people."""
    error: float | None = None
    """Standard error of that estimate."""


class Stamps(msgspec.Struct):
    """Summary of the timestamps."""

    images: int
    clouds: int
    fps: float | None
    """Median frames per second of the images' stamps."""


class Cameras(msgspec.Struct):
    """Medians over the cameras, and the constants for rows of the panorama, in pixels."""

    cameras: int
    fy: float
    focal_rows: float
    cy: float
    horizon_row: float
    agrees: bool


class Disagreement(msgspec.Struct):
    """Disagreement between the frames of a person, or between the records of the members of a group."""

    subject: str
    """`person 12` or `group 7`."""
    attribute: str
    votes: dict[str, int]
    """Frames or records with each value."""
    stated: int
    """Number of frames or records with the attribute."""


class SequenceReport(msgspec.Struct):
    """One row of the report. A row without a sequence describes the root as a whole.

    The layers are the layers of the `frames` table. Images and timestamps have no annotation step.
    """

    sequence: str
    problems: list[Problem]
    layers: list[str] = []
    steps: dict[str, int] = {}
    """Frames between annotated frames: 1, or 15 for one per second."""
    files: dict[str, str] = {}
    """Folder and name of the file of each layer."""
    frames: int = 0
    """Number of frames of all layers together."""
    people: int = 0
    boxes: int = 0
    boxes_3d: int = 0
    unknown_labels: list[UnknownLabel] = []
    heading: Heading | None = None
    label_frames: FrameRange | None = None
    image_frames: FrameRange | None = None
    shifts: list[ShiftCheck] = []
    stamps: Stamps | None = None
    cameras: Cameras | None = None
    disagreements: list[Disagreement] = []
    """Demographics and group information that differ between frames or members."""
    absent_partners: int = 0
    """Interactions without a fact, because one of the two people has no 2D box in the frame."""
    warnings: list[str] = []
    """Warnings for a person to check. Nothing was refused because of them."""

    @property
    def refused(self) -> int:
        """Number of refused or skipped files, frames, records and fields."""
        return sum(problem.count for problem in self.problems)


def frame_range(frames: npt.NDArray[np.int64]) -> FrameRange | None:
    """Return the range of ascending frames, or None without frames."""
    return FrameRange(int(frames[0]), int(frames[-1]), len(frames)) if len(frames) else None


def sequence_warnings(
    labels: FrameRange | None, images: FrameRange | None, heading: Heading | None, cameras: Cameras | None
) -> list[str]:
    """Return warnings for a person to check."""
    lines = []
    if labels and images and (labels.first, labels.last) != (images.first, images.last):
        lines.append(
            f"labels span frames {labels.first}-{labels.last}, images {images.first}-{images.last}: in copies of the "
            "train sequences the two are known to be off by 2 frames, which no file states; look with "
            "observe --panorama --boxes"
        )
    if heading and heading.moves >= MIN_MOVES and heading.median_deg is not None and heading.median_deg > MAX_TURN_DEG:
        lines.append(
            f"moving people face {heading.median_deg:.0f} degrees away from their direction: the headings of the 3D "
            "boxes may have another sign or zero than JRDB's"
        )
    if cameras and not cameras.agrees:
        lines.append(
            f"the cameras' medians fy {cameras.fy:.1f} and cy {cameras.cy:.1f} are far from {cameras.focal_rows} and "
            f"{cameras.horizon_row}, which rows of the panorama are computed with: is it another robot's calibration?"
        )
    return lines


def totals(reports: list[SequenceReport]) -> str:
    """Return one line about all sequences."""
    loaded = [report for report in reports if report.layers]
    sums = {name: sum(getattr(report, name) for report in loaded) for name in ("frames", "people", "boxes", "boxes_3d")}
    unknown = len({(label.field, label.label) for report in loaded for label in report.unknown_labels})
    sequences = "1 sequence" if len(loaded) == 1 else f"{len(loaded)} sequences"
    return (
        f"{sequences}, {sums['frames']:,} frames, {sums['people']:,} people, {sums['boxes']:,} boxes, "
        f"{sums['boxes_3d']:,} 3D boxes; {unknown} labels outside the vocabulary; "
        f"{sum(report.refused for report in reports):,} refused or skipped"
    )
