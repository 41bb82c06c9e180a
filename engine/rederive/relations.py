"""Who people are and whom and what they are with: attributes, groups, interactions and things handled."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any, Final

import pyarrow as pa

from jrdb_avr.engine.rederive.actions import Actions
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, in_closed_gap, rows, step_of
from jrdb_avr.schema.labels import AGES, GENDERS, OBJECTS, PERSON_CATEGORIES, POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules

_Said = dict[int, bool]
"""Frames at which something is said, and whether for certain."""

_WORDS: Final = {"gender": GENDERS, "age": AGES}


class Ties(Actions):
    """Social, group and reasoning labels of one sequence beside its boxes."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._chosen = _chosen(tables["demographics"])
        self._faces = _faces(tables["poses"])
        self._listed = {(layer, frame, track) for layer, frame, track in rows(tables["listed"], *_LISTED)}
        self._groups: dict[tuple[int, int], tuple[int, bool]] = {}
        self._clusters: dict[int, dict[int, _Said]] = defaultdict(lambda: defaultdict(dict))
        for frame, track, cluster, difficulty in rows(tables["groups"], "frame", "track", "cluster", "difficulty"):
            self._groups[frame, track] = (cluster, difficulty in (1, 2))
            self._clusters[track][cluster][frame] = difficulty in (1, 2)
        self._together: dict[tuple[int, int, str], _Said] = defaultdict(dict)
        columns = ("frame", "track", "partner", "label", "difficulty")
        for frame, track, partner, label, difficulty in rows(tables["interactions"], *columns):
            # Said of one of two people it holds of both; a partner without a box in the frame gives no fact.
            if self.box(track, frame) is not None and self.box(partner, frame) is not None:
                _say(self._together[min(track, partner), max(track, partner), label], frame, difficulty)
        names = dict(rows(tables["categories"], "category_id", "category"))
        self._handled: dict[int, dict[tuple[str, int, int], _Said]] = defaultdict(lambda: defaultdict(dict))
        things = rows(tables["handles"], "frame", "track", "object", "category_id", "verb", "difficulty")
        for frame, track, thing, category, verb, difficulty in things:
            if self.box(track, frame) is not None and names.get(category) not in PERSON_CATEGORIES:
                _say(self._handled[track][verb, category, thing], frame, difficulty)
        self._categories = {number: name for number, name in names.items() if name in OBJECTS}
        layers = ("groups", "interactions", "handles")
        self._steps = {layer: step_of(sorted(self.layers.get(layer, []))) for layer in layers}

    def _when(self, said: _Said, frame: int, layer: str) -> bool | None:
        """Whether something is said for certain at a frame, closed gaps counting as not certain; None: not at all.

        Of a layer with one frame per second, what two frames in a row say holds between them.
        """
        if frame in said:
            return said[frame]
        if self._steps[layer] == 1:
            return False if in_closed_gap(said.__contains__, frame, self.rules.load.gap_frames) else None
        for before in range(frame - KEYFRAME_STEP + 1, frame):
            if before in said and said.get(before + KEYFRAME_STEP) == said[before]:
                return said[before]
        return None

    def tells(self, track: int, frame: int, layer: str) -> bool:
        """Whether the whole list of a person could be read, so that what it lacks is false."""
        return (layer, frame, track) in self._listed

    # -- what a person is ---------------------------------------------------------------------------------------

    def attribute(self, track: int, name: str, wanted: str) -> int:
        """Gender or age: what more than half of the frames that tell it say."""
        value = self._chosen.get((track, name))
        return UNKNOWN if value not in _WORDS[name] else int(value == wanted)

    def face_visible(self, track: int, frame: int) -> bool:
        """Whether head or eyes can be seen; not asked where the sequence has no poses."""
        return not self.layers.get("pose") or self._faces.get((frame, track), False)

    # -- groups -------------------------------------------------------------------------------------------------

    def group_size(self, track: int, frame: int) -> int | None:
        """People in the person's group, oneself included; None where a membership that matters is unknown."""
        own = self._groups.get((frame, track))
        if own is None or not self.knows(frame):
            return None
        members = [self._groups.get((frame, other)) for other in self.people(frame)]
        if None in members:
            return None
        same = [member for member in members if member is not None and member[0] == own[0]]
        return len(same) if all(certain for _, certain in same) else None

    def same_group(self, track: int, other: int, frame: int) -> int:
        """Whether two people belong to one group."""
        mine, theirs = self._memberships(track, frame), self._memberships(other, frame)
        shared = mine.keys() & theirs.keys()
        if shared:
            return TRUE if any(mine[cluster] and theirs[cluster] for cluster in shared) else UNKNOWN
        return FALSE if mine and theirs else UNKNOWN

    def _memberships(self, track: int, frame: int) -> dict[int, bool]:
        """Groups that a person is or could be in, and whether certainly."""
        found = {}
        for cluster, said in self._clusters.get(track, {}).items():
            certain = self._when(said, frame, "groups")
            if certain is not None:
                found[cluster] = certain
        return found

    # -- interactions and things --------------------------------------------------------------------------------

    def together(self, track: int, other: int, label: str, frame: int) -> int:
        """Whether two people, both with a box at the frame, are in the interaction."""
        said = self._together.get((min(track, other), max(track, other), label))
        certain = None if said is None else self._when(said, frame, "interactions")
        if certain is not None:
            return TRUE if certain else UNKNOWN
        both = self.tells(track, frame, "interactions") and self.tells(other, frame, "interactions")
        return FALSE if both else UNKNOWN

    def interacts(self, track: int, label: str, frame: int) -> int:
        """Whether a person is in the interaction with anybody."""
        facts = {self.together(track, other, label, frame) for other in self.people(frame) if other != track}
        return TRUE if TRUE in facts else UNKNOWN if UNKNOWN in facts else FALSE

    def handles(self, track: int, verb: str, category: str, frame: int) -> int:
        """Whether a person does this with a thing of the category; a thing of unknown category could be one.

        What is a posture and no handling, and what is done with people, is not asked.
        """
        if verb in POSES or category in PERSON_CATEGORIES:
            return UNKNOWN
        possible = False
        for (done, number, _), said in self._handled.get(track, {}).items():
            of = self._categories.get(number)
            certain = self._when(said, frame, "handles") if done == verb and of in (category, None) else None
            if certain and of == category:
                return TRUE
            possible |= certain is not None
        return FALSE if not possible and self.tells(track, frame, "handles") else UNKNOWN


_LISTED: Final = ("layer", "frame", "track")


def _say(said: _Said, frame: int, difficulty: int | None) -> None:
    """Note one label; of several for one frame the easiest counts."""
    said[frame] = said.get(frame, False) or difficulty in (1, 2)


def _chosen(table: pa.Table) -> dict[tuple[int, str], str]:
    """(track, attribute) -> the value of more than half of the votes, one per frame and value that is easy to tell."""
    votes: set[Any] = set()
    for frame, track, attribute, value, difficulty in rows(table, "frame", "track", "attribute", "value", "difficulty"):
        if value is not None and difficulty in (1, 2):
            votes.add((track, attribute, value, frame))
    counts = Counter((track, attribute, value) for track, attribute, value, _ in votes)
    cast = Counter((track, attribute) for track, attribute, _, _ in votes)
    return {
        (track, attribute): value
        for (track, attribute, value), count in counts.items()
        if 2 * count > cast[track, attribute]
    }


def _faces(table: pa.Table) -> dict[tuple[int, int], bool]:
    """(frame, track) -> whether head, right eye or left eye, the first three points, is marked visible (2)."""
    points = table["keypoints"].combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(-1, 51)
    seen = (points[:, [2, 5, 8]] == 2).any(axis=1).tolist()
    return {(frame, track): face for (frame, track), face in zip(rows(table, "frame", "track"), seen, strict=True)}
