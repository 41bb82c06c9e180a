"""Raw label files of one sequence as plain records: what the text reader knows of the world.

It reads the JSON itself and shares no code with the loaders. Every record of a frame is kept that may be a person:
one without a usable number gets a negative one, so that it can still be somebody who fits a description.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

WIDTH = 3760
SOCIAL = ("labels_2d_activity_social_stitched", "labels_2d_social")
REASONING = ("labels_2d_stitched_new_version", "labels_2d_stitched_test_new_version1")
PANOPTIC = ("labels_2d_panoptic_stitched_CW", "labels_2d_panoptic_stitched_OW")
CERTAIN = 2
"""The highest difficulty code of a label that annotators were sure of."""


@dataclass
class Seen:
    """One record of a person in one frame."""

    box: tuple[float, float, float, float] | None
    hidden: bool | None = None
    doubtful: bool = False
    actions: dict[str, int] = field(default_factory=dict)
    group: object = None
    grouping: int = 3
    partners: dict[tuple[str, int], int] | None = None
    things: dict[tuple[str, str], int] | None = None
    place: tuple[float, float, float] | None = None
    heading: float | None = None
    metres: float | None = None

    @property
    def angle(self) -> float:
        x, _, width, _ = self.box
        return (x + width / 2) / WIDTH * 360 % 360


def code(value) -> int:
    """A difficulty from 1 to 3; what cannot be read is as doubtful as the hardest."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return 3
    return int(number) if number in (1, 2, 3) else 3


@cache
def plain(label: str) -> str:
    """One spelling of a label."""
    text = re.sub(r"[_\-\s]+", " ", str(label)).strip().lower().replace("something", "sth")
    return re.sub(r"\btogether together\b", "together", text)


def labels_of(value) -> dict[str, int]:
    return {plain(name): code(level) for name, level in value.items()} if isinstance(value, dict) else {}


def track_of(label) -> int | None:
    """The number of a person, 0 for a person without one, and None for a thing."""
    text = str(label).strip()
    if found := re.fullmatch(r"pedestrian:(\d+)", text):
        return int(found[1]) + 1
    return 0 if re.match(r"(ped|person|people|human|rider|bicyclist|other)", text, re.IGNORECASE) else None


def listed(record: dict, *keys: str) -> list | None:
    for key in keys:
        if isinstance(record.get(key), list):
            return [entry for entry in record[key] if isinstance(entry, dict)]
    return None


class Recording:
    """People by frame of one sequence. Numbers of people are those of the files; strangers have negative ones."""

    def __init__(self, root: Path, sequence: str):
        self.root, self.sequence = root, sequence
        self.frames: dict[int, dict[int, Seen]] = {}
        self.votes: dict[int, dict[str, Counter]] = defaultdict(lambda: defaultdict(Counter))
        for frame, records in self.records("labels_2d_stitched"):
            self.frames[frame] = self.people(records)
        for frame, records in self.records(*SOCIAL):
            self.add_social(frame, records)
        for frame, records in self.records(*REASONING):
            self.add_social(frame, records, absent_means_empty=True)
        for frame, records in self.records("labels_3d"):
            self.add_places(frame, records)
        gaps = Counter(later - first for first, later in zip(self.order, self.order[1:], strict=False))
        self.step = gaps.most_common(1)[0][0] if gaps else 1

    @cached_property
    def order(self) -> list[int]:
        return sorted(self.frames)

    def file(self, *folders: str) -> dict:
        for folder in folders:
            for path in (self.root / "labels" / folder, self.root / folder):
                if (path / f"{self.sequence}.json").exists():
                    return json.loads((path / f"{self.sequence}.json").read_text("utf-8"))
        return {}

    def records(self, *folders: str):
        for name, records in self.file(*folders).get("labels", {}).items():
            if isinstance(records, list) and (stem := Path(name).stem).isdigit():
                yield int(stem), [record for record in records if isinstance(record, dict)]

    def people(self, records: list[dict]) -> dict[int, Seen]:
        people: dict[int, Seen] = {}
        for record in records:
            number = track_of(record.get("label_id"))
            if number is None:
                continue
            # The second of two records of a number may be somebody else's.
            unnumbered = not number or number - 1 in people
            people[-1 - len(people) if unnumbered else number - 1] = self.seen(record)
        return people

    def seen(self, record: dict) -> Seen:
        box, marks = record.get("box"), record.get("attributes")
        usable = isinstance(box, list) and len(box) == 4 and all(isinstance(side, int | float) for side in box)
        marks = marks if isinstance(marks, dict) else {}
        occlusion = marks.get("occlusion")
        group = record.get("social_group")
        group = group if isinstance(group, dict) else {}
        return Seen(
            box=tuple(box) if usable and box[2] > 0 and box[3] > 0 else None,
            hidden=None if occlusion is None else occlusion not in ("Fully_visible", "Mostly_visible"),
            doubtful=marks.get("no_eval") in (True, "true"),
            actions=labels_of(record.get("action_label")),
            group=group.get("cluster_ID"),
            grouping=code(group.get("cluster_stat")),
        )

    def known(self, frame: int, record: dict) -> tuple[int, Seen] | None:
        number = track_of(record.get("label_id"))
        seen = self.frames.get(frame, {}).get(number - 1) if number else None
        return None if seen is None or not number else (number - 1, seen)

    def add_social(self, frame: int, records: list[dict], absent_means_empty: bool = False) -> None:
        for record in records:
            if (found := self.known(frame, record)) is None:
                continue
            number, seen = found
            if absent_means_empty:
                record = {"HHI": [], "HOI": [], **record}
            for entry in listed(record, "demographics_info") or ():
                for kind in ("gender", "age"):
                    for value, level in labels_of(entry.get(kind)).items():
                        if level <= CERTAIN and value != "impossible":
                            self.votes[number][kind][value] += 1
            if (entries := listed(record, "H-interaction", "HHI")) is not None:
                seen.partners = {} if seen.partners is None else seen.partners
                for entry in entries:
                    other = entry.get("pair")
                    other = (
                        track_of(other) if isinstance(other, str) and ":" in other else track_of(f"pedestrian:{other}")
                    )
                    for label, level in labels_of(entry.get("inter_labels")).items():
                        key = (label, (other or 0) - 1)
                        seen.partners[key] = min(level, seen.partners.get(key, 3))
            if (entries := listed(record, "HOI")) is not None:
                seen.things = {} if seen.things is None else seen.things
                for entry in entries:
                    pair = entry.get("pair")
                    kind = self.kinds.get(int(pair[1]), "") if isinstance(pair, list) and len(pair) == 2 else ""
                    for verb, level in labels_of(entry.get("inter_labels")).items():
                        seen.things[verb, kind] = min(level, seen.things.get((verb, kind), 3))

    @cached_property
    def kinds(self) -> dict[int, str]:
        """Names of things by category number."""
        return {
            row["id"]: re.sub(r"^[tm] ", "", plain(row["name"])) for row in self.file(*PANOPTIC).get("categories", [])
        }

    def add_places(self, frame: int, records: list[dict]) -> None:
        for record in records:
            found, box = self.known(frame, record), record.get("box")
            marks = record.get("attributes") or {}
            if found is None or not isinstance(box, dict) or not marks.get("num_points"):
                continue
            try:
                seen, place = found[1], (float(box["cx"]), float(box["cy"]), float(box["cz"]))
                seen.place, seen.heading = place, math.pi - float(box["rot_z"])
            except (KeyError, TypeError, ValueError):
                continue
            metres = marks.get("distance")
            seen.metres = float(metres) if isinstance(metres, int | float) else math.hypot(*place[:2])
