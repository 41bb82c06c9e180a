"""The 2D boxes of each frame, from the annotation tables."""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping
from typing import Literal, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.rederive.covering import Outline, covered_area, outline_of
from jrdb_avr.engine.rederive.truth import rows, step_of
from jrdb_avr.schema.labels import CLEAR_OCCLUSIONS, COVERED_OCCLUSIONS
from jrdb_avr.schema.panorama import HEIGHT, Box, center_angle
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules

ViewClass = Literal["clear", "covered", "uncertain"]
"""Class of a person with a box in a frame. "covered": certainly not in clear view. "uncertain": all other people."""


class _Person2D(NamedTuple):
    """2D box with the other values of its record."""

    box: Box
    occlusion: str | None
    no_eval: bool
    listed: bool


class PersonBoxes:
    """Boxes of one sequence, indexed by frame and by person, and the frames that its layers know.

    Attributes:
        rules: Thresholds.
        layers: Annotated frames by layer.
        judges_views: Whether the rules classify people as clear, covered or uncertain.
        has_attributes: Whether the degrees of occlusion decide about views.
        keyframes: Keyframes of the sequence.
    """

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        self.rules = rules
        self.layers: dict[str, list[int]] = defaultdict(list)
        for layer, frame in rows(tables["frames"], "layer", "frame"):
            self.layers[layer].append(frame)
        self._known = {layer: set(numbers) for layer, numbers in self.layers.items()}
        boxes = tables["boxes_2d"]
        self.judges_views = rules.load.visibility == "clear"
        if self.judges_views:
            self.has_attributes = boxes["occlusion"].null_count < len(boxes)
        else:
            self.has_attributes = bool(pc.any(boxes["has_attributes"]).as_py())
        self._groups: dict[tuple[int, int], tuple[int, bool]] = {}
        for frame, track, cluster, difficulty in rows(tables["groups"], "frame", "track", "cluster", "difficulty"):
            self._groups[frame, track] = (cluster, difficulty in (1, 2))
        self._grouped_frames = sorted({frame for frame, _ in self._groups})
        self._views: dict[tuple[int, int], ViewClass] = {}
        self._outlines: dict[int, dict[int, Outline]] = {}
        self._people: dict[int, dict[int, _Person2D]] = defaultdict(dict)
        columns = ("frame", "track", "x", "y", "w", "h", "occlusion", "no_eval", "has_actions")
        for frame, track, x, y, w, h, occlusion, no_eval, listed in rows(boxes, *columns):
            self._people[frame][track] = _Person2D(Box(x, y, w, h), occlusion, bool(no_eval), listed)
        self._tracks: dict[int, list[int]] = defaultdict(list)
        for frame in sorted(self._people):
            for track in self._people[frame]:
                self._tracks[track].append(frame)
        self.keyframes = self._find_keyframes()

    def _find_keyframes(self) -> frozenset[int]:
        leading = next((layer for layer in ("actions", "2d", "3d") if self.layers.get(layer)), "")
        numbers = sorted(self.layers.get(leading, []))
        if numbers and step_of(numbers) == 1:
            numbers = [f for f in range(numbers[0], numbers[-1] + 1) if f % KEYFRAME_STEP == 0]
        # Because a frame with boxes that the 2D layer does not list may have more people with unreadable boxes.
        return frozenset(f for f in numbers if self.knows(f) or not self._people.get(f))

    def knows(self, frame: int, layer: str = "2d") -> bool:
        """Return whether a layer has this frame, so that in it a fact without a label is false, and not unknown."""
        return frame in self._known.get(layer, ())

    def frames_between(self, first: int, last: int) -> range:
        """Return the frames between two frames of the 2D layer that the layer should know."""
        step = step_of(sorted(self.layers.get("2d", [])))
        return range(first + step, last, step)

    def boxes(self, track: int) -> dict[int, Box]:
        """Return every 2D box of a person by frame."""
        return {frame: self._people[frame][track].box for frame in self._tracks.get(track, [])}

    def box(self, track: int, frame: int) -> Box | None:
        """Return the person's 2D box, or None."""
        person = self._people.get(frame, {}).get(track)
        return None if person is None else person.box

    def angle(self, track: int, frame: int) -> float:
        """Return the panorama angle, in degrees, of the centre of a person's box. The box must exist."""
        box = self._people[frame][track].box
        return center_angle(box.x, box.w)

    def people(self, frame: int) -> list[int]:
        """Return all people with a 2D box at the frame, in order."""
        return sorted(self._people.get(frame, {}))

    def clear(self, track: int, frame: int) -> bool:
        """Return whether the person is in clear view. False without a 2D box."""
        return self.box(track, frame) is not None and self.view(track, frame) == "clear"

    def covered(self, track: int, frame: int) -> bool:
        """Return whether the person is covered, so that questions ignore the person. False without a 2D box."""
        return self.box(track, frame) is not None and self.view(track, frame) == "covered"

    def uncovered_people(self, frame: int) -> list[int]:
        """Return all people with a 2D box at the frame who are not covered, in order."""
        return [track for track in self.people(frame) if self.view(track, frame) != "covered"]

    def view(self, track: int, frame: int) -> ViewClass:
        """Return the class of a person with a 2D box at the frame."""
        key = (track, frame)
        if key not in self._views:
            self._views[key] = self._judge(track, frame)
        return self._views[key]

    def _judge(self, track: int, frame: int) -> ViewClass:
        person = self._people[frame][track]
        load, box = self.rules.load, person.box
        fits = load.clear_min_width <= box.w <= load.clear_max_width and box.h >= load.clear_min_height
        usable = fits and box.y >= 0 and box.y + box.h <= HEIGHT and not person.no_eval
        if self.has_attributes:
            if self.judges_views and person.occlusion in COVERED_OCCLUSIONS:
                return "covered"
            return "clear" if usable and person.occlusion in CLEAR_OCCLUSIONS else "uncertain"
        if not self.judges_views:
            return "clear" if usable else "uncertain"
        if frame not in self._outlines:
            self._outlines[frame] = {rival: outline_of(other.box) for rival, other in self._people[frame].items()}
        outline = self._outlines[frame][track]
        if outline.area <= 0:
            return "uncertain"
        thousandths = 1000 * covered_area(outline, self._outlines[frame].values())
        if thousandths >= round(1000 * load.min_covered) * outline.area:
            return "covered"
        visible = usable and thousandths < round(1000 * load.max_covered) * outline.area
        return "clear" if visible and self._has_certain_group(track, frame) else "uncertain"

    def _has_certain_group(self, track: int, frame: int) -> bool:
        """Return whether the nearest frame with group labels, up to a second away, has an easy label of the person."""
        labelled = self._grouped_frames
        index = bisect_left(labelled, frame)
        near = [at for at in labelled[max(index - 1, 0) : index + 1] if abs(at - frame) <= KEYFRAME_STEP]
        nearest = min(near, key=lambda at: abs(at - frame), default=-1)
        return not labelled or self._groups.get((nearest, track), (0, False))[1]

    def absent(self, track: int, frame: int) -> bool:
        """Return whether the person is certainly absent: without a box at the frame, one second before and after."""
        near = (frame - KEYFRAME_STEP, frame, frame + KEYFRAME_STEP)
        return all(self.knows(f) and self.box(track, f) is None for f in near)

    def has_image(self, frame: int) -> bool:
        """Return whether the frame has an image. True for all frames of a sequence without images."""
        return "images" not in self._known or self.knows(frame, "images")
