"""What a run of ticks says, as one entry per person and frame, for the lists that label files repeat on every frame.

What the social and the reasoning files hold beside the boxes: demographics, interactions, groups, handled things.

Lists are written as JSON text: most of them stay the same from frame to frame, and a sequence has up to a million.

Timestamps of images and clouds, and the calibration of the cameras: files that are no labels.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.synthetic.box_files import HARD, LabelFrame, Quirks, annotated, occlusion, spans
from jrdb_avr.loaders.synthetic.objects import category_code
from jrdb_avr.loaders.synthetic.script import Rng
from jrdb_avr.loaders.synthetic.world import World, rng_of
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, VERBS
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.social import AIMS


@dataclass(frozen=True)
class Entries:
    """Entries sorted by frame and person, arrays of n: the person who has the entry, its run, its other end (a person
    or a thing) and its difficulty; `start` (frames + 1) tells where each frame's begin."""

    person: Ints
    run: Ints
    other: Ints
    level: Ints
    start: Ints

    def at(self, frame: int) -> list[tuple[int, int, int, int]]:
        """(person, run, other, level) of a frame."""
        part = slice(int(self.start[frame]), int(self.start[frame + 1]))
        columns = (self.person, self.run, self.other, self.level)
        return list(zip(*(column[part].tolist() for column in columns), strict=True))


def _frames_of(world: World, first: Ints, last: Ints) -> tuple[Ints, Ints]:
    """The runs' places repeated once per frame, and those frames."""
    begin = world.starts[first]
    length = world.starts[last + 1] - begin
    run = np.repeat(np.arange(len(first)), length)
    before = np.cumsum(length) - length
    return run, np.arange(length.sum()) - before[run] + begin[run]


def _sorted(world: World, frame: Ints, person: Ints, run: Ints, other: Ints, level: Ints) -> Entries:
    order = np.lexsort((run, other, person, frame))
    start = np.searchsorted(frame[order], np.arange(world.frames + 1))
    return Entries(person[order], run[order], other[order], level[order], start)


def _levels(draw: Floats, hidden: Bools) -> Ints:
    """Hard labels are mostly those of people who are covered; one draw per run, as for actions."""
    return np.where(draw < np.where(hidden, 0.5, 0.04), HARD, 1 + (draw * 64).astype(np.int64) % 2)


def of_bonds(world: World, one_way: Ints) -> Entries:
    """Entries of interactions, both directions; `one_way` per run: 0 both, 1 or 2 only that of the first or second."""
    bonds = world.bonds
    here, hidden = annotated(world), occlusion(world) >= 2
    run, frame = _frames_of(world, bonds.first, bonds.last)
    run, frame = np.tile(run, 2), np.tile(frame, 2)
    back = np.arange(len(run)) >= len(run) // 2
    person = np.where(back, bonds.b[run], bonds.a[run])
    other = np.where(back, bonds.a[run], bonds.b[run])
    # A partner may have no box: annotators name also whom another box hides.
    keep = here[frame, person] & world.present[frame, other]
    keep &= np.where(back, one_way[run] != 1, one_way[run] != 2)
    run, frame, person, other = run[keep], frame[keep], person[keep], other[keep]
    level = _levels(bonds.draw[run], hidden[frame, person] | hidden[frame, other])
    return _sorted(world, frame, person, run, other, level)


def of_handling(world: World) -> Entries:
    """Entries of things handled."""
    handling = world.things.handling
    here, hidden = annotated(world), occlusion(world) >= 2
    run, frame = _frames_of(world, handling.first, handling.last)
    person, thing = handling.person[run], handling.thing[run]
    keep = here[frame, person]
    run, frame, person, thing = run[keep], frame[keep], person[keep], thing[keep]
    return _sorted(world, frame, person, run, thing, _levels(handling.draw[run], hidden[frame, person]))


def some(rng: Rng, count: int, share: float) -> Bools:
    """Which of `count` runs are chosen, a share of them but always one where there are any."""
    chosen = rng.random(count) < share
    if count and not chosen.any():
        chosen[int(rng.integers(count))] = True
    return chosen


_EMPTY: Final = msgspec.Raw(b"[]")

_VENUES: Final = {
    "plaza": "outdoor_open_area/campus",
    "cafe": "indoor_cafeteria/dining_hall/food_court",
    "hall": "indoor_open_space/corridor",
    "library": "indoor_study_space",
    "street": "outdoor_street",
    "lobby": "indoor_open_space/corridor",
    "atrium": "indoor_room/class",
    "campus": "outdoor_open_area/campus",
    "market": "outdoor_cafeteria/dining_hall/food_court",
}
_AIMS: Final = (*AIMS, "socializing&eating/ordering_food")
_BODY_ON: Final = ("floor", "chair", "ground", "pathway", "sidewalk", "bench")
_NEAR: Final = ("table", "wall", "board", "pillar", "door", "poster", "trolley", "window", "robot", "baggage")

_SPELLINGS: Final = {
    "standing together": "standing together together",
    "looking at sth together": "looking at something together",
    "looking into sth together": "looking into something together",
    "pointing at sth together": "pointing at something together",
    "holding sth together": "holding something together",
    "walking together": "walking_together",
}

Lists = dict[int, msgspec.Raw]
"""By a person's place, the text of one of its lists; who is not in it has an empty one."""


class Social:
    """Writes the lists of one sequence."""

    def __init__(self, world: World, quirks: Quirks, category_ids: list[int]) -> None:
        self._world = world
        rng = rng_of(world.seed, world.name, "social")
        self._hidden = occlusion(world) >= 2
        everywhere = np.ones(self._hidden.shape, bool)
        self._untold = spans(rng, self._hidden, 0.0008, 5, 40)
        self._key_missing = spans(rng, self._hidden, 0.0004, 5, 30)
        self._says_other = spans(rng, everywhere, 0.00012, 5, 20)
        self._group_other = spans(rng, everywhere, 0.00012, 5, 20)
        self._person_draw = rng.random(len(world.people))
        self._persons = [_person_texts(rng, world, i) for i in range(len(world.people))]
        self._groups = _group_texts(rng, world)
        count = len(world.bonds.first)
        self._bonds = of_bonds(world, rng.choice(3, size=count, p=[0.93, 0.04, 0.03]))
        self._twice = some(rng, count, 0.02).tolist()
        self._words = _words(world, rng.random(count))
        self._handled = of_handling(world)
        self._pairs = _thing_texts(rng, world, category_ids)

    @property
    def interactions(self) -> int:
        """Entries of `H-interaction` in the whole sequence."""
        return len(self._bonds.person)

    def social(self, one: LabelFrame) -> list[dict[str, Any]]:
        """Records of the social file at a frame of the 2D file."""
        together = self._interactions(one.frame)
        rows = []
        for i, record in zip(one.people, one.records, strict=True):
            row = {**record, "demographics_info": self._demographics(one.frame, i)}
            if not self._key_missing[one.frame, i]:
                row["H-interaction"] = together.get(i, _EMPTY)
            row["group_info"] = self._group(one.frame, i)
            rows.append(row)
        return rows + one.foreign

    def reasoning(self, one: LabelFrame) -> list[dict[str, Any]]:
        """Records of the reasoning file: other names, and empty lists mostly left out."""
        together, handled = self._interactions(one.frame), self._handles(one.frame)
        sizes = Counter(record["social_group"]["cluster_ID"] for record in one.records if "social_group" in record)
        rows = []
        for i, record in zip(one.people, one.records, strict=True):
            row = {**record, "demographics_info": self._demographics(one.frame, i)}
            if i in together or i % 3 == 0:
                row["HHI"] = together.get(i, _EMPTY)
            if i in handled or i % 5 == 0:
                row["HOI"] = handled.get(i, _EMPTY)
            row["group_info"] = self._group(one.frame, i)
            if "social_group" in record:
                row["group_size"] = sizes[record["social_group"]["cluster_ID"]]
            rows.append(row)
        return rows + one.foreign

    def _demographics(self, frame: int, i: int) -> msgspec.Raw:
        if self._untold[frame, i]:
            return _EMPTY
        texts = self._persons[i]
        if self._says_other[frame, i]:
            return texts["other"]
        draw = self._person_draw[i]
        if self._hidden[frame, i] and draw < 0.4:
            return texts["impossible" if draw < 0.12 else "hard"]
        return texts["plain"]

    def _group(self, frame: int, i: int) -> msgspec.Raw:
        plain, other = self._groups[self._world.people[i].party]
        if self._world.apart[frame, i]:
            return _EMPTY
        return other if self._group_other[frame, i] else plain

    def _interactions(self, frame: int) -> Lists:
        boxes = self._world.boxes[frame].tolist()
        texts: dict[int, list[str]] = {}
        for i, run, j, level in self._bonds.at(frame):
            x, y, w, h = boxes[j]
            track = self._world.people[j].track
            text = (
                f'{{"pair":"pedestrian:{track}","box_pair":[{x},{y},{w},{h}],'
                f'"inter_labels":{{"{self._words[run]}":"{level}"}}}}'
            )
            texts.setdefault(i, []).extend([text] * (1 + self._twice[run]))
        return _lists(texts)

    def _handles(self, frame: int) -> Lists:
        texts: dict[int, list[str]] = {}
        for i, run, _, level in self._handled.at(frame):
            texts.setdefault(i, []).append(self._pairs[run].replace("LEVEL", str(level)))
        return _lists(texts)


def _lists(texts: dict[int, list[str]]) -> Lists:
    return {i: msgspec.Raw(f"[{','.join(some)}]".encode()) for i, some in texts.items()}


def _person_texts(rng: Rng, world: World, i: int) -> dict[str, msgspec.Raw]:
    """`demographics_info` of a person: as it is, hard, impossible, and a slip of the annotators."""
    person = world.people[i]

    def text(gender: str, age: str, levels: list[int], ethnicity: str = person.ethnicity) -> msgspec.Raw:
        labels = {"gender": gender.title(), "age": age.replace(" ", "_").title(), "race": ethnicity}
        if gender == "impossible":
            labels = dict.fromkeys(labels, "impossible")
        element = {key: {label: str(level)} for (key, label), level in zip(labels.items(), levels, strict=True)}
        return msgspec.Raw(msgspec.json.encode([element]))

    slip = (GENDERS[person.gender == GENDERS[0]], person.age)
    if i % 2:
        slip = (person.gender, AGES[(AGES.index(person.age) + 1) % len(AGES)])
    return {
        "plain": text(person.gender, person.age, rng.integers(1, 3, 3).tolist()),
        "hard": text(person.gender, person.age, [HARD] * 3),
        "impossible": text("impossible", person.age, [1, 1, 1]),
        "other": text(*slip, [2, 2, 2]),
    }


def _group_texts(rng: Rng, world: World) -> list[tuple[msgspec.Raw, msgspec.Raw]]:
    """`group_info` per party: what all its members carry, and what one says who disagrees; empty for one alone."""
    out = []
    for index, party in enumerate(world.parties):
        if len(party.members) == 1:
            out.append((_EMPTY, _EMPTY))
            continue
        aims, near = rng.permutation(len(_AIMS)), rng.permutation(len(_NEAR))
        level = str(int(rng.choice([1, 2, 3], p=[0.55, 0.33, 0.12])))
        done = Counter(world.bonds.label[np.isin(world.bonds.a, party.members)].tolist())
        element = {
            "venue": {_venue(world.name, index): "1"},
            "aim": {_AIMS[aims[0]]: level},
            "inter": {INTERACTIONS[label]: "1" for label, _ in sorted(done.most_common(2))},
            "BPC": {_BODY_ON[int(rng.integers(len(_BODY_ON)))]: "1"},
            "SSC": {_NEAR[near[0]]: "1", **({_NEAR[near[1]]: "2"} if rng.random() < 0.4 else {})},
            "location_pre": {"at": "1"},
        }
        slip = element | {"aim": {_AIMS[aims[1]]: "2"}, "SSC": {_NEAR[near[2]]: "1"}}
        out.append((msgspec.Raw(msgspec.json.encode([element])), msgspec.Raw(msgspec.json.encode([slip]))))
    return out


def _venue(sequence: str, party: int) -> str:
    """The place that the sequence's name tells; one party in five writes it with a colon."""
    venue = _VENUES[sequence.split("-")[1]]
    return venue.replace("_", ":", 1) if party % 5 == 4 else venue


def _words(world: World, draw: Any) -> list[str]:
    """The label of each run, a few of them in another spelling; more of those that are rare."""
    labels = [INTERACTIONS[label] for label in world.bonds.label.tolist()]
    odd = [one < (0.4 if "sth" in label else 0.04) for label, one in zip(labels, draw.tolist(), strict=True)]
    return [_SPELLINGS.get(label, label) if other else label for label, other in zip(labels, odd, strict=True)]


def _thing_texts(rng: Rng, world: World, category_ids: list[int]) -> list[str]:
    """The entry of each run of handling, with LEVEL in the place of its difficulty; some pairs hold texts."""
    handling = world.things.handling
    out = []
    for thing, verb, text in zip(
        handling.thing.tolist(), handling.verb.tolist(), (rng.random(len(handling.thing)) < 0.1).tolist(), strict=True
    ):
        one = world.things.things[thing]
        numbers = [one.number, category_ids[category_code(one)]]
        pair = ",".join(f'"{number}"' if text else str(number) for number in numbers)
        out.append(f'{{"inter_labels":{{"{VERBS[verb]}":"LEVEL"}},"pair":[{pair}]}}')
    return out


_CAMERAS: Final = (0, 2, 4, 6, 8)
_LIDARS: Final = ("upper_velodyne", "lower_velodyne")
_EPOCH: Final = 1_549_000_000
"""Seconds: the sample's sequences were taken in the weeks after this."""
_LONGER: Final = 3
"""The timestamps reach some frames further than the labels."""


def frames_img(world: World) -> Iterator[bytes]:
    """`timestamps/<sequence>/frames_img.json`."""
    yield _file(world, "cameras", [(f"image_{n}", f"images/image_{n}/{world.name}/{{}}.jpg") for n in _CAMERAS], 0.0)


def frames_pc(world: World) -> Iterator[bytes]:
    """`timestamps/<sequence>/frames_pc.json`; clouds come up to 40 ms after the images."""
    sensors = [(name, f"pointclouds/{name}/{world.name}/{{}}.pcd") for name in _LIDARS]
    yield _file(world, "pointclouds", sensors, 0.02)


def _file(world: World, key: str, sensors: list[tuple[str, str]], late: float) -> bytes:
    rng = rng_of(world.seed, world.name, "timestamps", key)
    count = world.frames + _LONGER
    start = _EPOCH + int(rng_of(world.seed, world.name, "epoch").integers(0, 6_000_000))
    times = start + np.arange(count) / FPS + late + rng.uniform(-0.004, 0.004, count)
    rows: list[dict[str, Any]] = []
    for frame, time in enumerate(np.round(times, 6).tolist()):
        parts = [
            {"name": name, "url": url.format(f"{frame:06d}"), "timestamp": round(time + 0.0001 * k, 6)}
            for k, (name, url) in enumerate(sensors)
        ]
        rows.append({"frame_id": frame, "timestamp": time, key: parts})
    return msgspec.json.encode({"data": rows})


def calibration_files() -> dict[str, str]:
    """Name -> text of `calibration/*.yaml`, laid out like the published ones; the numbers are the sample's own."""
    cameras = ["stitching:", "  radius: 3360000", "  rotation: 0", "  scalewidth: 1831", "  crop: 1", "cameras:"]
    for number in range(10):
        cameras += [
            f"  sensor_{number}:",
            "    width: 752",
            "    height: 480",
            "    D: -0.34 0.16 0.0001 -0.0001 -0.045",
            "    # K = fx 0 cx, 0 fy cy, 0 0 1",
            "    K: >",
            f"      {480.0 + 0.5 * number:g} 0 {355.0 + number:g}",
            f"      0 {482.9 + 0.5 * number:g} {209.4 - number:g}",
            "      0 0 1",
            "    R: >",
            "      1 0 0",
            "      0 1 0",
            "      0 0 1",
            "    T: 0 0 -56.9",
        ]
    lidars = [
        "%YAML 1.2",
        "---",
        "lidar:",
        "  upper2ego:",
        "  - [1.0, 0.0, 0.0, 0.0]",
        "  - [0.0, 1.0, 0.0, 0.0]",
        "  - [0.0, 0.0, 1.0, 0.33529]",
        "  - [0.0, 0.0, 0.0, 1.0]",
    ]
    for number in _CAMERAS:
        lidars += [
            f"sensor_{number}:",
            "  D: [-0.34, 0.16, 0.0001, -0.0001, -0.045]",
            "  distorted_img_K:",
            f"  - [{480.0 + 0.5 * number:g}, 0.0, {355.0 + number:g}]",
            f"  - [0.0, {482.9 + 0.5 * number:g}, {209.4 - number:g}]",
            "  - [0.0, 0.0, 1.0]",
        ]
    defaults = [
        "calibrated:",
        "  lidar_upper_to_rgb:",
        "    translation: [0, 0, -0.33529]",
        "    rotation: [0, 0, 0.085]",
        "  lidar_lower_to_rgb:",
        "    translation: [0, 0, 0.13511]",
        "    rotation: [0, 0, 0]",
        "image:",
        "  width: 3760",
        "  height: 480",
        "  stitched_image_offset: 1880",
    ]
    texts = {"cameras": cameras, "lidars": lidars, "defaults": defaults}
    return {f"{name}.yaml": "\n".join(lines) + "\n" for name, lines in texts.items()}
