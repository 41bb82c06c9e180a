"""Mutated label files of every layer: never a traceback, never a fact that a brute-force reader does not see.

A seed names a mutation: `check_file(seed, ...)`.
"""

from __future__ import annotations

import random
import re
from collections import Counter

from mutate import mutate
from oracle_files import RefusedError, read
from worlds import CAMERAS, STAMPS, as_bytes, member, person, person_3d, pose, thing

from jrdb_avr.loaders.layers.social import load_reasoning
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.loaders.sequence import READERS
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

NAME = "yard-2020-01-01_0"
SEEDS = range(200)
"""Frames of a sequence whose derived tables are compared: the oracle walks from the first to the last."""


def placed(track, frame):
    return (200 * track + 3 * frame, 60, 50, 200)


def social_record(track, frame, **more):
    told = {"gender": {"Male": "1"}, "age": {"Young_Adulthood": "2"}, "race": {"impossible": "1"}}
    info = {"venue": {"indoor_room/class": "1"}, "aim": {"socializing&commuting": "1"}, "SSC": {"table": "2"}}
    talk = [((track + 1) % 3, {"conversation": "1"}), ((track + 2) % 3, {"hugging": "3"})]
    return member(track, placed(track, frame), told, talk, info, group=(7, 1), **more)


def clean_world():
    """A small world that has every layer and every field."""
    frames = (0, 1, 2, 15)
    actions = {"walking": 1, "holding sth": "2"}
    return {
        "2d": {
            f: [
                person(t, placed(t, f), actions, (7, 1), social_activity={"sitting": 1.0}, file_id="000002.jpg")
                for t in range(3)
            ]
            for f in frames
        },
        "3d": {f: [person_3d(t, 2.0 + t, 1.0, heading=0.3) for t in range(3)] for f in frames},
        "social": {f: [social_record(t, f) for t in range(3)] for f in frames},
        "reasoning": {
            f: [
                social_record(t, f, handles=[((1, 40), {"holding": "1"}), (("2", "71"), {"opening": 2})])
                for t in (0, 1)
            ]
            for f in frames
        },
        "pose": {f: [pose(t, 200.0 * t, visibility=[2, 1, 0] * 5 + [2, 1]) for t in range(3)] for f in (0, 15)},
        "panoptic": {
            f: [thing(1, 40), thing(2, 71, where="attributes.tracking_id"), thing(None, 4), thing(3, 900)]
            for f in (0, 15)
        },
        "timestamps": {
            "images": {f: 1549500000.0 + f / 15 for f in range(17)},
            "clouds": {f: 1549500000.01 + f / 15 for f in range(17)},
        },
        "calibration": CAMERAS,
    }


WORLD = clean_world()
FILES = {layer: content for layer, content in WORLD.items() if layer != "timestamps"} | WORLD["timestamps"]
DATA = {layer: as_bytes(content, layer) for layer, content in FILES.items()}

FACTS = {
    "boxes_2d": ("frame", "track", "x", "y", "w", "h"),
    "actions": ("frame", "track", "action", "raw"),
    "groups": ("frame", "track", "cluster"),
    "social_activities": ("frame", "track", "activity"),
    "boxes_3d": ("frame", "track", "cx", "cy", "cz", "l", "w", "h", "rot_z"),
    "demographics": ("frame", "track", "attribute", "raw"),
    "interactions": ("frame", "track", "partner", "label", "raw"),
    "group_info": ("frame", "track", "attribute", "raw"),
    "handles": ("frame", "track", "object", "category_id", "verb", "raw"),
    "listed": ("layer", "frame", "track"),
    "poses": ("frame", "track", "keypoints"),
    "panoptic": ("frame", "category_id"),
    "categories": ("category_id", "raw"),
    "timestamps": ("sensor", "frame", "timestamp"),
}
"""Per table the columns that make a fact; the others add to it, and null (or false of what is there) adds nothing."""
ADDED_FLAGS = ("has_attributes", "has_actions")
UNSEEN = ("segmentation",)


def key_of(table, row):
    return tuple(tuple(row[name]) if isinstance(row[name], list) else row[name] for name in FACTS[table])


def load_file(folder, layer, data):
    """(reading or None where the file is refused, problems) of one file."""
    problems = Problems("x.json")
    if layer in STAMPS:
        path = folder / STAMPS[layer][0]
        path.write_bytes(data)
        path, reader = folder, READERS["timestamps"]
    else:
        path = folder / ("cameras.yaml" if layer == "calibration" else f"{NAME}.json")
        path.write_bytes(data)
        reader = READERS.get(layer) or (lambda *arguments: load_reasoning(*arguments, social=True))
    try:
        return reader(path, problems).of(NAME), problems
    except InputError as error:
        assert str(error) and "\n" not in str(error)
        return None, problems
    finally:
        for file in folder.iterdir():
            file.unlink()


def seen_by_brute_force(layer, data):
    """Facts per table by key, of both readings of repeated keys; and those of both, which nobody may lose silently."""
    seen, frames, plain = {}, {}, []
    for last in (False, True):
        for every in (False, True):
            try:
                found = read(layer, data, last, every)
            except RefusedError:
                continue
            for table, rows in found.tables.items():
                for row in rows:
                    seen.setdefault(table, {}).setdefault(key_of(table, row), []).append(row)
            for name, known in found.frames.items():
                frames.setdefault(name, set()).update(known)
            if not every:
                plain.append({table: {key_of(table, row) for row in rows} for table, rows in found.tables.items()})
    sure = {table: plain[0][table] & plain[1].get(table, set()) for table in plain[0]} if len(plain) == 2 else {}
    return seen, frames, sure


def check_calibration(reading, data):
    """Every number of a camera stands in the text."""
    text = data.decode("utf-8", "replace")
    numbers = {
        float(token) for token in re.findall(r"(?<![\w.])[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?", text) if usable(token)
    }
    for row in reading.tables["calibration"].to_pylist():
        values = [row[name] for name in ("width", "height", "fx", "fy", "cx", "cy")]
        assert {float(value) for value in values if value is not None} <= numbers, row


def usable(token):
    try:
        float(token)
    except ValueError:
        return False
    return True


def check_facts(layer, reading, problems, data):
    """Nothing that brute force does not see, and nothing lost without a word. Returns the number of facts."""
    seen, frames, sure = seen_by_brute_force(layer, data)
    held = {}
    for table, rows in reading.tables.items():
        extra = [name for name in ANNOTATIONS[table].names if name not in (*FACTS[table], "sequence", *UNSEEN)]
        held[table] = set()
        for row in rows.to_pylist():
            key = key_of(table, row)
            held[table].add(key)
            candidates = seen.get(table, {}).get(key, [])
            assert any(
                all(row[name] in (None, other[name]) or (name in ADDED_FLAGS and not row[name]) for name in extra)
                for other in candidates
            ), (table, row, candidates)
    for name, (known, _) in reading.frames.items():
        assert set(known.tolist()) <= frames.get(name, set()), (name, known, frames.get(name))
    lost = {table: keys - held.get(table, set()) for table, keys in sure.items()}
    if any(lost.values()):
        assert problems.listed(), lost
    return sum(map(len, held.values()))


def check_file(seed, folder):
    """One mutated file of one layer, read by its own loader. Returns what became of it."""
    rng = random.Random(seed)
    layer = rng.choice(sorted(DATA))
    data, names = mutate(rng, DATA[layer])
    try:
        reading, problems = load_file(folder, layer, data)
        if reading is None:
            return layer, "refused"
        if layer == "calibration":
            check_calibration(reading, data)
            return layer, "kept"
        check_facts(layer, reading, problems, data)
        return layer, "kept" if not problems.listed() else "kept in part"
    except Exception as error:
        error.add_note(f"seed {seed}: {layer} after {', '.join(names)}: {data[:2000]!r}")
        raise


def test_clean_files_are_read_as_by_brute_force(tmp_path):
    """The comparison itself: nothing is refused, and every table of every layer has facts."""
    filled = set()
    for layer, data in DATA.items():
        reading, problems = load_file(tmp_path, layer, data)
        assert reading is not None and problems.listed() == [], layer
        if layer == "calibration":
            check_calibration(reading, data)
            filled |= {"calibration"}
            continue
        check_facts(layer, reading, problems, data)
        filled |= {table for table, rows in reading.tables.items() if rows.num_rows}
        seen, frames, _ = seen_by_brute_force(layer, data)
        for table, rows in reading.tables.items():
            assert len({key_of(table, row) for row in rows.to_pylist()}) == len(seen.get(table, ())), table
        assert {name: set(known.tolist()) for name, (known, _) in reading.frames.items()} == frames
    assert filled == set(ANNOTATIONS) - {"frames"}


def test_mutated_files_give_no_fact_that_is_not_there(tmp_path):
    became = Counter(check_file(seed, tmp_path) for seed in SEEDS)
    # Of every layer files are refused, kept in part and kept: the mutations reach all of the code.
    for layer in DATA:
        assert became[layer, "refused"] and became[layer, "kept"], became
    assert sum(count for (_, what), count in became.items() if what == "kept in part") > len(SEEDS) / 10
