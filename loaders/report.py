"""The load report: per sequence what was found, loaded and refused."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.problems import Problem

MIN_MOVES: Final = 100
MAX_TURN_DEG: Final = 90.0
"""A median angle between heading and displacement above this speaks against the headings; a moving robot blurs it."""


class UnknownLabel(msgspec.Struct):
    """A label outside the vocabulary, in its normal spelling."""

    field: str
    label: str
    count: int


class Heading(msgspec.Struct):
    """Self-check of the heading convention: people faster than 0.5 m/s should face where they go."""

    moves: int
    """Displacements over one second that were looked at."""
    median_deg: float | None
    """Median angle between heading and displacement; near 0 when the convention holds, near 180 when it is reversed."""


class FrameRange(msgspec.Struct):
    """Frames that are there, from the first to the last."""

    first: int
    last: int
    count: int


class ShiftCheck(msgspec.Struct):
    """Whether the frame numbers of a layer's file are those of the 2D boxes, judged by the people they share."""

    layer: str
    result: str
    """`agrees`; `shifted`: refused; `not tested`: nothing speaks against the layer, and nothing for it."""
    reason: str
    frames: float | None = None
    """How many frames later in the 2D layer the layer's boxes fit best, estimated from moving people."""
    error: float | None = None
    """Standard error of that estimate."""


class Stamps(msgspec.Struct):
    """Summary of the timestamps."""

    images: int
    clouds: int
    fps: float | None
    """Median frames per second of the images' stamps."""


class Cameras(msgspec.Struct):
    """Medians over the cameras, beside the constants that rows of the panorama are computed with, in pixels."""

    cameras: int
    fy: float
    focal_rows: float
    cy: float
    horizon_row: float
    agrees: bool


class Disagreement(msgspec.Struct):
    """Frames of a person, or records of a group's members, that disagree."""

    subject: str
    """`person 12` or `group 7`."""
    attribute: str
    votes: dict[str, int]
    """Frames or records with each value."""
    told: int
    """Frames or records that state the attribute."""


class SequenceReport(msgspec.Struct):
    """One row of the report. Layers are those of the `frames` table; images and timestamps have no annotation step.

    A row without a sequence is about the root as a whole.
    """

    sequence: str
    problems: list[Problem]
    layers: list[str] = []
    steps: dict[str, int] = {}
    """Frames between annotated frames: 1, or 15 for one per second."""
    files: dict[str, str] = {}
    """What was read for each layer: the folder and the name of the file."""
    frames: int = 0
    """Frames that any layer knows."""
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
    """Interactions that gave no fact, as one of the two has no 2D box in the frame."""
    warnings: list[str] = []
    """What a person should look at; nothing was refused for it."""

    @property
    def refused(self) -> int:
        """Files, frames, records and fields refused or skipped."""
        return sum(problem.count for problem in self.problems)


def frame_range(frames: npt.NDArray[np.int64]) -> FrameRange | None:
    """The range of ascending frames; None without any."""
    return FrameRange(int(frames[0]), int(frames[-1]), len(frames)) if len(frames) else None


def sequence_warnings(
    labels: FrameRange | None, images: FrameRange | None, heading: Heading | None, cameras: Cameras | None
) -> list[str]:
    """What a person should look at."""
    found = []
    if labels and images and (labels.first, labels.last) != (images.first, images.last):
        found.append(
            f"labels span frames {labels.first}-{labels.last}, images {images.first}-{images.last}: in copies of the "
            "train sequences the two are known to be off by 2 frames, which no file tells; look with "
            "observe --panorama --boxes"
        )
    if heading and heading.moves >= MIN_MOVES and heading.median_deg is not None and heading.median_deg > MAX_TURN_DEG:
        found.append(
            f"people who move face {heading.median_deg:.0f} degrees away from where they go: the headings of the 3D "
            "boxes may have another sign or zero than JRDB's"
        )
    if cameras and not cameras.agrees:
        found.append(
            f"the cameras' medians fy {cameras.fy:.1f} and cy {cameras.cy:.1f} are far from {cameras.focal_rows} and "
            f"{cameras.horizon_row}, which rows of the panorama are computed with: is it another robot's calibration?"
        )
    return found


def totals(reports: list[SequenceReport]) -> str:
    """One line over all sequences."""
    loaded = [report for report in reports if report.layers]
    sums = {name: sum(getattr(report, name) for report in loaded) for name in ("frames", "people", "boxes", "boxes_3d")}
    unknown = len({(label.field, label.label) for report in loaded for label in report.unknown_labels})
    sequences = "1 sequence" if len(loaded) == 1 else f"{len(loaded)} sequences"
    return (
        f"{sequences}, {sums['frames']:,} frames, {sums['people']:,} people, {sums['boxes']:,} boxes, "
        f"{sums['boxes_3d']:,} 3D boxes; {unknown} labels outside the vocabulary; "
        f"{sum(report.refused for report in reports):,} refused or skipped"
    )
