"""Write the social and reasoning files of a simulated sequence: demographics, interactions, groups, handled things.

They hold the records of the 2D file with lists beside the boxes, repeated on every frame. The lists are written as JSON
text: most of them stay the same from frame to frame, and a sequence has up to a million.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Final

import msgspec
import numpy as np

from jrdb_avr.loaders.synthetic.box_files import HARD_CODE, LabelFrame, _Record
from jrdb_avr.loaders.synthetic.coco_files import category_ids
from jrdb_avr.loaders.synthetic.interactions import RelationRuns
from jrdb_avr.loaders.synthetic.script import Rng, one_of
from jrdb_avr.loaders.synthetic.world import World, spans
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import AGES, AIMS, GENDERS, INTERACTIONS
from jrdb_avr.schema.things import OBJECTS, VERBS

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
"""Text of one of a person's lists, by the person's index. Other people have an empty list."""


class Entries:
    """Relations with one entry per person and frame, sorted by frame and person.

    An entry has the person, the run, the other end (a person or a thing) and the difficulty. `start` (frames + 1) has
    the index of the first entry of each frame.
    """

    def __init__(self, world: World, runs: RelationRuns, directions: Ints | None = None) -> None:
        """Make the entries of people with a box.

        `directions` (runs) of relations between two people: 0 both, 1 or 2 only that of the first or the second.
        """
        begin = world.starts[runs.first]
        length = world.starts[runs.last + 1] - begin
        run = np.repeat(np.arange(len(begin)), length)
        frame = np.arange(len(run)) - (np.cumsum(length) - length)[run] + begin[run]
        person, target = runs.person[run], runs.target[run]
        if directions is not None:
            sense = np.repeat((1, 2), len(run))
            run, frame = np.tile(run, 2), np.tile(frame, 2)
            person, target = np.append(person, target), np.append(target, person)
            # A partner may have no box, because annotators also name people behind another box.
            kept = world.present[frame, target] & ((directions[run] == 0) | (directions[run] == sense))
            run, frame, person, target = (column[kept] for column in (run, frame, person, target))
        boxed = world.boxed[frame, person]
        run, frame, person, target = (column[boxed] for column in (run, frame, person, target))
        hidden = world.hidden[frame, person]
        if directions is not None:
            hidden = hidden | world.hidden[frame, target]
        # Hard labels are mostly those of people who are covered; one draw per run, as for actions.
        draw = runs.draw[run]
        level = np.where(draw < np.where(hidden, 0.5, 0.04), HARD_CODE, 1 + (draw * 64).astype(np.int64) % 2)
        order = np.lexsort((run, target, person, frame))
        self.start = np.searchsorted(frame[order], np.arange(world.frames + 1))
        self.person, self.run, self.target, self.level = person[order], run[order], target[order], level[order]

    def at(self, frame: int) -> list[tuple[int, int, int, int]]:
        """Return (person, run, other, level) of a frame."""
        part = slice(int(self.start[frame]), int(self.start[frame + 1]))
        columns = (self.person, self.run, self.target, self.level)
        return list(zip(*(column[part].tolist() for column in columns), strict=True))


class SocialFiles:
    """Writer of the lists of one sequence. `interactions` is the number of entries of `H-interaction` in it."""

    def __init__(self, world: World) -> None:
        self._world = world
        rng = world.rng("social")
        everywhere = np.ones(world.hidden.shape, bool)
        self._undescribed = spans(rng, world.hidden, 0.0008, 5, 40)
        self._key_missing = spans(rng, world.hidden, 0.0004, 5, 30)
        self._other_person = spans(rng, everywhere, 0.00012, 5, 20)
        self._other_group = spans(rng, everywhere, 0.00012, 5, 20)
        self._person_draw = rng.random(len(world.people))
        self._persons = [_person_texts(rng, world, i) for i in range(len(world.people))]
        self._groups = _group_texts(rng, world)
        count = len(world.interactions.first)
        self._bonds = Entries(world, world.interactions, rng.choice(3, size=count, p=[0.93, 0.04, 0.03]))
        self.interactions = len(self._bonds.person)
        self._twice = _some(rng, count, 0.02).tolist()
        self._labels = _written_labels(rng, world)
        self._handled = Entries(world, world.things.handling)
        self._pairs = _thing_texts(rng, world)

    def records(self, item: LabelFrame) -> tuple[list[_Record], list[_Record]]:
        """Return records of the social and of the reasoning file at a frame of the 2D file.

        The reasoning file has other names, and mostly leaves out empty lists.
        """
        together, handled = self._interactions(item.frame), self._handles(item.frame)
        sizes = Counter(record["social_group"]["cluster_ID"] for record in item.records if "social_group" in record)
        social, reasoning = [], []
        for i, record in zip(item.people, item.records, strict=True):
            described = record | {"demographics_info": self._demographics(item.frame, i)}
            group = {"group_info": self._group(item.frame, i)}
            entries = together.get(i, _EMPTY)
            social.append(described | ({} if self._key_missing[item.frame, i] else {"H-interaction": entries}) | group)
            row = described
            if i in together or i % 3 == 0:
                row = row | {"HHI": entries}
            if i in handled or i % 5 == 0:
                row = row | {"HOI": handled.get(i, _EMPTY)}
            row = row | group
            if "social_group" in record:
                row["group_size"] = sizes[record["social_group"]["cluster_ID"]]
            reasoning.append(row)
        return social + item.foreign, reasoning + item.foreign

    def _demographics(self, frame: int, i: int) -> msgspec.Raw:
        if self._undescribed[frame, i]:
            return _EMPTY
        texts = self._persons[i]
        if self._other_person[frame, i]:
            return texts["other"]
        draw = self._person_draw[i]
        if self._world.hidden[frame, i] and draw < 0.4:
            return texts["impossible" if draw < 0.12 else "hard"]
        return texts["plain"]

    def _group(self, frame: int, i: int) -> msgspec.Raw:
        if self._world.apart[frame, i]:
            return _EMPTY
        return self._groups[self._world.people[i].party][int(self._other_group[frame, i])]

    def _interactions(self, frame: int) -> Lists:
        boxes = self._world.boxes[frame].tolist()
        texts: dict[int, list[str]] = defaultdict(list)
        for i, run, j, level in self._bonds.at(frame):
            x, y, w, h = boxes[j]
            text = (
                f'{{"pair":"pedestrian:{self._world.people[j].track}","box_pair":[{x},{y},{w},{h}],'
                f'"inter_labels":{{"{self._labels[run]}":"{level}"}}}}'
            )
            texts[i] += [text] * (1 + self._twice[run])
        return _lists(texts)

    def _handles(self, frame: int) -> Lists:
        texts: dict[int, list[str]] = defaultdict(list)
        for i, run, _, level in self._handled.at(frame):
            texts[i].append(self._pairs[run].replace("LEVEL", str(level)))
        return _lists(texts)


def _lists(texts: dict[int, list[str]]) -> Lists:
    return {i: msgspec.Raw(f"[{','.join(some)}]".encode()) for i, some in texts.items()}


def _text(element: _Record) -> msgspec.Raw:
    return msgspec.Raw(msgspec.json.encode([element]))


def _some(rng: Rng, count: int, share: float) -> Bools:
    """Choose a share of `count` runs, at least one if there are any."""
    chosen = rng.random(count) < share
    if count and not chosen.any():
        chosen[int(rng.integers(count))] = True
    return chosen


def _person_texts(rng: Rng, world: World, i: int) -> dict[str, msgspec.Raw]:
    """Return `demographics_info` of a person: as it is, hard, impossible, and with a slip of the annotators."""
    person = world.people[i]

    def text(gender: str, age: str, levels: list[int], ethnicity: str = person.ethnicity) -> msgspec.Raw:
        labels = {"gender": gender.title(), "age": age.replace(" ", "_").title(), "race": ethnicity}
        if gender == "impossible":
            labels = dict.fromkeys(labels, "impossible")
        element = {key: {label: str(level)} for (key, label), level in zip(labels.items(), levels, strict=True)}
        return _text(element)

    slip = (GENDERS[person.gender == GENDERS[0]], person.age)
    if i % 2:
        slip = (person.gender, AGES[(AGES.index(person.age) + 1) % len(AGES)])
    return {
        "plain": text(person.gender, person.age, rng.integers(1, 3, 3).tolist()),
        "hard": text(person.gender, person.age, [HARD_CODE] * 3),
        "impossible": text("impossible", person.age, [1, 1, 1]),
        "other": text(*slip, [2, 2, 2]),
    }


def _group_texts(rng: Rng, world: World) -> list[tuple[msgspec.Raw, msgspec.Raw]]:
    """Return `group_info` per party: the entry of its members, and a differing entry. Both are empty for one person."""
    out = []
    for index, party in enumerate(world.parties):
        if len(party.members) == 1:
            out.append((_EMPTY, _EMPTY))
            continue
        aims, near = rng.permutation(len(_AIMS)), rng.permutation(len(_NEAR))
        level = str(int(rng.choice([1, 2, 3], p=[0.55, 0.33, 0.12])))
        done = Counter(world.interactions.label[np.isin(world.interactions.person, party.members)].tolist())
        element = {
            "venue": {_venue(world.name, index): "1"},
            "aim": {_AIMS[aims[0]]: level},
            "inter": {INTERACTIONS[label]: "1" for label, _ in sorted(done.most_common(2))},
            "BPC": {one_of(rng, _BODY_ON): "1"},
            "SSC": {_NEAR[near[0]]: "1", **({_NEAR[near[1]]: "2"} if rng.random() < 0.4 else {})},
            "location_pre": {"at": "1"},
        }
        slip = element | {"aim": {_AIMS[aims[1]]: "2"}, "SSC": {_NEAR[near[2]]: "1"}}
        out.append((_text(element), _text(slip)))
    return out


def _venue(sequence: str, party: int) -> str:
    """Return the venue of the sequence's name. One party in five writes it with a colon."""
    venue = _VENUES[sequence.split("-")[1]]
    return venue.replace("_", ":", 1) if party % 5 == 4 else venue


def _written_labels(rng: Rng, world: World) -> list[str]:
    """Return the label of each run, some in another spelling, rare labels more often."""
    labels = [INTERACTIONS[label] for label in world.interactions.label.tolist()]
    odd = [
        draw < (0.4 if "sth" in label else 0.04) for label, draw in zip(labels, rng.random(len(labels)), strict=True)
    ]
    return [_SPELLINGS.get(label, label) if target else label for label, target in zip(labels, odd, strict=True)]


def _thing_texts(rng: Rng, world: World) -> list[str]:
    """Return the entry of each run of handling, with LEVEL for its difficulty. Some pairs hold texts."""
    runs, numbers = world.things.handling, category_ids(world)
    out = []
    for thing, verb, as_text in zip(
        runs.target.tolist(), runs.label.tolist(), rng.random(len(runs.target)) < 0.1, strict=True
    ):
        item = world.things.things[thing]
        pair = [item.number, numbers[OBJECTS.index(item.category)]]
        entry = {"inter_labels": {VERBS[verb]: "LEVEL"}, "pair": [str(number) for number in pair] if as_text else pair}
        out.append(msgspec.json.encode(entry).decode())
    return out
