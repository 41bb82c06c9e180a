"""What a perfect observer is told of a crop: facts of the people in it, from the raw label files alone.

Plain Python over the rows of `oracle_reading`, with the facts of one person in one frame from `oracle_facts`; shares no
code with the loaders, the queries or the engine. Only people with a clear view of whom at least half lies in the crop
are told of, only what is certainly true of them, and nothing of who is not there: an observer cannot know what hides
behind somebody. Boxes end where the crop ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from oracle_facts import CENTERS, Oracle, distance_words, off_axis
from oracle_reading import read
from oracle_words import POSES

LAYERS = {
    "2d": "labels_2d_stitched",
    "3d": "labels_3d",
    "social": "labels_2d_activity_social_stitched",
    "reasoning": "labels_2d_stitched_new_version",
    "panoptic": "labels_2d_panoptic_stitched_CW",
}


@dataclass(frozen=True)
class Seen:
    """A person in a crop. `box` (x, y, w, h) in stitched pixels, x from the crop's left column on; `cut` is -1 or 1
    where the box reaches the crop's left or right edge. `ties` are (label, the other's name) of interactions, the name
    None for somebody out of view; `handles` (category, verb). `place` (x, y, z) and `distance` in metres and `heading`
    in radians, in the robot's frame.
    """

    name: int
    frame: int
    box: tuple[float, float, float, float]
    cut: int
    gender: str | None
    age: str | None
    doing: frozenset[str]
    ties: frozenset[tuple[str, int | None]]
    handles: frozenset[tuple[str, str]]
    group: int | None
    group_size: int | None
    sector: str | None
    distance: float | None
    distance_word: str | None
    place: tuple[float, float, float] | None
    heading: float | None = field(default=None)

    @property
    def pose(self):
        return next(iter(self.doing & POSES), None)

    @property
    def angle(self):
        x, _, w, _ = self.box
        return (x + w / 2) / 3760 * 360 % 360


class SequenceFacts:
    """The certain facts of one sequence, by frame and person."""

    def __init__(self, root, sequence):
        found = {
            layer: read(layer, (Path(root) / "labels" / folder / f"{sequence}.json").read_bytes())
            for layer, folder in LAYERS.items()
        }
        self.boxes = found["2d"]
        self.boxes.tables["boxes_3d"] = found["3d"].rows("boxes_3d")
        self.people = Oracle(self.boxes, sequence)
        self.told = self._chosen(found["social"].rows("demographics"))
        self.ties = {}
        for row in found["social"].rows("interactions"):
            pair = row["track"], row["partner"]
            if row["difficulty"] in (1, 2) and all((row["frame"], one) in self.people.people for one in pair):
                for one, other in (pair, pair[::-1]):
                    self.ties.setdefault((row["frame"], one), set()).add((row["label"], other))
        categories = {row["category_id"]: row["category"] for row in found["panoptic"].rows("categories")}
        self.handles = {}
        for row in found["reasoning"].rows("handles"):
            if row["difficulty"] in (1, 2) and row["category_id"] in categories:
                what = categories[row["category_id"]], row["verb"]
                self.handles.setdefault((row["frame"], row["track"]), set()).add(what)

    @staticmethod
    def _chosen(rows):
        """{(track, attribute): value} of what all the telling frames say."""
        votes = {}
        for row in rows:
            if row["value"] is not None and row["difficulty"] in (1, 2):
                votes.setdefault((row["track"], row["attribute"]), set()).add(row["value"])
        return {key: min(values) for key, values in votes.items() if len(values) == 1}

    def inside(self, frame, left):
        """Everybody with a clear view and at least half of the box in the 480 columns from `left` on."""
        for track in self.people.in_frame(frame):
            if self.people.clear(frame, track):
                box = self.people.people[frame, track]
                x, w = box["x"], box["w"]
                x = left + (x - left + 1880) % 3760 - 1880
                start, stop = max(x, left), min(x + w, left + 480)
                if stop - start >= w / 2:
                    cut = -1 if start == left else 1 if stop == left + 480 else 0
                    yield self._seen(frame, track, (start, box["y"], stop - start, box["h"]), cut)

    def _seen(self, frame, track, box, cut):
        people, key = self.people, (frame, track)
        located = people.located.get(key)
        angle = people.angle(frame, track)
        distance = word = place = heading = None
        if located is not None:
            row = self._place(located)
            distance, word, place, heading = row
        cluster, code = people.clusters.get(key, (None, None))
        return Seen(
            name=track,
            frame=frame,
            box=box,
            cut=cut,
            gender=self.told.get((track, "gender")),
            age=self.told.get((track, "age")),
            doing=frozenset(action for action in people.actions[key] if people.certain(frame, track, action)),
            ties=frozenset(
                (label, partner if people.clear(frame, partner) else None) for label, partner in self.ties.get(key, ())
            ),
            handles=frozenset(self.handles.get(key, ())),
            group=cluster if code in (1, 2) else None,
            group_size=people.group_size(frame, track),
            sector=next((name for name in CENTERS if off_axis(angle, name) <= 40), None),
            distance=distance,
            distance_word=word,
            place=place,
            heading=heading,
        )

    @staticmethod
    def _place(box):
        place = box["cx"], box["cy"], box["cz"]
        metres = (place[0] ** 2 + place[1] ** 2) ** 0.5 if box["distance"] is None else box["distance"]
        word, other = distance_words(metres)
        return metres, word if other is None else None, place, 3.141592653589793 - box["rot_z"]


class Teller:
    """Tells of any observation of the sequences under a root; reads each sequence once."""

    def __init__(self, root):
        self.root = root
        self.sequences = {}

    def __call__(self, observation):
        name = observation.sequence
        if name not in self.sequences:
            self.sequences[name] = SequenceFacts(self.root, name)
        return list(self.sequences[name].inside(observation.frame_index, observation.left))
