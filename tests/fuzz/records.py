"""Mutated records of every layer: no error but the loaders' own, and no fact that the files do not hold.

A case is one sequence of which records are changed in stretches of frames, loaded and compared with the clean load.
Half of the cases change records in any way: rows of other frames stay, and what is derived changes only within the
windows of the rules. The other half only makes records unreadable: then, in addition, nothing becomes certain.
"""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path
from random import Random

import certain
import limits
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from label_files import changed, read_label_file, stays_apart, unreadable, unreadable_group, unreadable_key
from random_worlds import random_world
from worlds import CAMERAS, write_root

from jrdb_avr.loaders.intervals.derive import derive
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.sequence import annotate
from jrdb_avr.loaders.synthetic.write import Order, sequence_name, write_sequence
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules

NAME = "yard-2020-01-01_0"
SAMPLE = sequence_name(1)
CASES_PER_WORLD = 40
LONGEST_SEARCH = 40
"""Seconds for which the changes of a failing case are made fewer."""
_RULES = LoadRules()


class World:
    """A clean sequence on disk, its files as records, and what its load gives."""

    def __init__(self, folder, seed, number):
        rng = Random(f"{seed} world {number}")
        self.root = Path(folder) / f"world{number}"
        if number % 3 == 2:
            write_root(self.root, _rich_world(rng))
        else:
            frames, people = ((450, 7), (150, 14), (300, 9))[number // 3 % 3]
            write_sequence(Order(str(self.root), SAMPLE, 1000 * seed + number, frames, people, "none"))
            (self.root / "calibration").mkdir()
            (self.root / "calibration" / "cameras.yaml").write_text(CAMERAS)
        (self.sequence,) = find_root(self.root).sequences
        self.files = []
        for layer, path in self.sequence.labels.items():
            if layer == "2d":
                _leave_some_out(rng, Path(path))
            if layer == "timestamps":
                self.files += [read_label_file(layer, file) for file in sorted(Path(path).iterdir())]
            elif layer == "2d" or path != self.sequence.labels.get("2d"):
                self.files.append(read_label_file(layer, Path(path)))
        for file in self.files:
            file.path.write_bytes(file.text({}))
        self.clean = load_tables(self.sequence)
        frames = self.clean[1]["frames"]["frame"].to_numpy()
        self.first, self.last = int(frames[0]), int(frames[-1])
        self.facts = certain.certain_facts(self.clean[1])
        self.facts |= certain.false_facts(self.clean[1], self.clean[1])
        self.gaps = certain.closed_gaps(self.clean[1])


def _leave_some_out(rng, path):
    """Set `no_eval` for a few boxes of a file, so that mutations can be seen to bring one back into clear view."""
    content = json.loads(path.read_bytes())
    for records in content["labels"].values():
        for record in records:
            if rng.random() < 0.03 and isinstance(record.get("attributes"), dict):
                record["attributes"]["no_eval"] = rng.choice((True, "true"))
    path.write_text(json.dumps(content))


def _rich_world(rng):
    """A random world of which most layers are there."""
    while True:
        world = random_world(rng, NAME)
        layers = set(world[NAME])
        if {"2d", "3d"} <= layers and len(layers) > 3 and sum(map(len, world[NAME]["2d"].values())) > 40:
            world[NAME].setdefault("calibration", CAMERAS)
            world[NAME].pop("images", None)
            return world


def load_tables(sequence):
    """(annotation tables, interval tables, problems) of a load; no intervals where it is refused."""
    found = annotate(sequence)
    if not found.frames:
        return found.tables, None, found.problems
    try:
        return found.tables, derive(sequence.sequence, found.tables, _RULES), found.problems
    except InputError as error:
        assert str(error) and "\n" not in str(error)
        return found.tables, None, found.problems


class Case:
    """The changes of one case, and the check of their load."""

    def __init__(self, world, rng):
        self.world = world
        self.only_unreadable = rng.random() < 0.5
        self.changes = {}
        files = [file for file in world.files if rng.random() < rng.choice((0.3, 1.0))] or [world.files[0]]
        self.frames = _stretches(rng, world.first, world.last, edges=self.only_unreadable)
        density = rng.choice((0.05, 0.4, 0.9, 0.95, 0.95))
        if self.only_unreadable and rng.random() < 0.1:
            n, file = rng.choice([(n, file) for n, file in enumerate(world.files) if file.layer != "calibration"])
            self.changes = {(n, *place): text for place, text in unreadable_key(rng, file).items()}
            return
        for n, file in enumerate(world.files):
            if file not in files:
                continue
            for g, group in enumerate(file.groups):
                frames = {frame for frame, _ in group.records}
                if len(frames) == 1 and frames <= self.frames and rng.random() < 0.02:
                    self.changes[n, g, None] = unreadable_group(rng, group)
                    continue
                for r, (frame, raw) in enumerate(group.records):
                    # What belongs to no frame, as the names of categories, is changed now and then only.
                    if rng.random() < (density if frame in self.frames else 0.01 if frame is None else 0.0):
                        text = (unreadable if self.only_unreadable else changed)(rng, file, raw)
                        if file.layer == "calibration" or stays_apart(text):
                            self.changes[n, g, r] = text

    @property
    def records(self):
        """How many records are changed; of an unreadable frame all of them."""
        files = self.world.files
        return sum(1 if r is not None else len(files[n].groups[g].records) for n, g, r in self.changes)

    def write(self, changes, root=None):
        """Write the world's files with changes, into another folder if one is given."""
        for n, file in enumerate(self.world.files):
            own = {(g, r): text for (m, g, r), text in changes.items() if m == n}
            path = file.path if root is None else Path(root) / file.path.relative_to(self.world.root)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.text(own))

    def check(self, changes):
        """Load the world with these changes. Raises AssertionError, or what the loader lets through."""
        self.write(changes)
        limits.begin()
        try:
            tables, intervals, problems = load_tables(self.world.sequence)
            if intervals is None:
                return "refused"
            layers = {problem.layer for problem in problems if problem.kind == "file"}
            whole = not any(
                problem.kind == "file" and problem.layer not in ("timestamps", "calibration") for problem in problems
            )
            facts = certain.certain_facts(intervals) | certain.false_facts(intervals, self.world.clean[1])
            if self.only_unreadable and whole:
                self._check_gain(facts, intervals)
            if whole:
                self._check_windows(changes, tables, facts, intervals)
            return "kept" if whole else "without " + ", ".join(sorted(layers))
        finally:
            for n in {n for n, _, _ in changes}:
                file = self.world.files[n]
                file.path.write_bytes(file.text({}))

    def _check_gain(self, facts, intervals):
        found = certain.gained(self.world.facts, facts)
        # Which frames are keyframes is no fact about them: without its 2D boxes a sequence has those of its 3D boxes.
        found.pop("keyframe", None)
        for kind in _AT_KEYFRAMES & found.keys():
            known = np.isin(found[kind]["frame"], self.world.facts["keyframe"]["frame"])
            found[kind] = certain.of_rows(found[kind], known)
        # A closed gap holds a segment together, where a label of somebody who is not in clear view ends it.
        for kind in ("segment", "closed segment"):
            if kind in found:
                found[kind] = certain.of_rows(
                    found[kind], ~certain.with_gaps(found[kind], intervals["possible_actions"])
                )
        found = {kind: rows for kind, rows in found.items() if len(rows["frame"])}
        # A gap is closed between two labels that are read: where one of them is lost, its frames' own lists count.
        denied = {kind: found.pop(kind) for kind in self.world.gaps if kind in found}
        found |= certain.gained(self.world.gaps, denied)
        assert not found, ("became certain", _some(found))
        before, after = (
            {
                tuple(row.values()): votes
                for row in table.to_pylist()
                if (votes := row.pop("votes")) and row.pop("chosen") is not None
            }
            for table in (self.world.clean[1]["demographics"], intervals["demographics"])
        )
        more = {key: votes for key, votes in after.items() if votes > before.get(key, 0)}
        assert not more, ("votes were won", more)

    def _check_windows(self, changes, tables, facts, intervals):
        files, (clean, derived, _) = self.world.files, self.world.clean
        frames = {files[n].groups[g].records[0 if r is None else r][0] for n, g, r in changes}
        unnamed, frames = None in frames, np.array(sorted(frames - {None}), np.int64)
        # A record of these layers names its frame itself, and may come to name any other.
        moved = set() if self.only_unreadable else {files[n].layer for n, _, _ in changes} & set(_BY_THEMSELVES)
        if unnamed:
            moved.add("panoptic")
        apart = {name for layer in moved for name in _BY_THEMSELVES[layer]}
        for name, table in clean.items():
            if "frame" in table.column_names and name not in apart:
                before, after = (_rows_outside(of[name], frames, moved) for of in (clean, tables))
                _compare(name, before, after)
        (then,), (now,) = (of["sequence"].to_pylist() for of in (derived, intervals))
        if any(then[name] != now[name] for name in ("has_attributes", "action_step", "layers")):
            return
        slow = any(len(f) > 1 and np.gcd.reduce(np.diff(np.sort(f))) % KEYFRAME_STEP == 0 for f in _frames_of(clean))
        for kind, rows in self.world.facts.items():
            if kind == "segment":
                near = certain.QUIET + KEYFRAME_STEP
                _compare(
                    kind,
                    *(
                        certain.of_rows(x, ~_meets(frames, x["first"] - near, x["last"] + near))
                        for x in (rows, facts[kind])
                    ),
                )
            if kind in certain.ELSEWHERE or kind in apart:
                continue
            reach = certain.REACH.get(kind, 0)
            # Between the labels of two keyframes a fact holds as well.
            reach = max(reach, KEYFRAME_STEP if slow else 0)
            _compare(
                kind,
                *(
                    certain.of_rows(x, ~_meets(frames, x["frame"] - reach, x["frame"] + reach))
                    for x in (rows, facts[kind])
                ),
            )


_AT_KEYFRAMES = {"beside", "not first beside", "not near"}

_BY_THEMSELVES = {
    "pose": ("poses", "face_visible"),
    "panoptic": ("panoptic", "object", "handling", "no handling"),
    "timestamps": ("timestamps",),
}
"""Layers whose records name their frames, and what of the tables and facts comes from them."""


def _meets(frames, first, last):
    """Whether any of some frames lies in [first, last], per interval."""
    return np.searchsorted(frames, first, "left") < np.searchsorted(frames, last, "right")


def _frames_of(tables):
    """The frames of each layer of people."""
    known = tables["frames"]
    names = ("2d", "actions", "groups", "interactions", "handles")
    return [known.filter(pc.equal(known["layer"], name))["frame"].to_numpy() for name in names]


def _rows_outside(table, frames, layers):
    """The rows of an annotation table that are not of some frames and layers, as columns."""
    table = table.filter(pa.array(~np.isin(table["frame"].to_numpy(), frames)))
    if "layer" in table.column_names and layers:
        table = table.filter(pc.invert(pc.is_in(table["layer"].cast(pa.string()), pa.array(sorted(layers)))))
    if "keypoints" in table.column_names:
        numbers = table["keypoints"].combine_chunks().flatten().to_numpy().reshape(-1, 51)
        table = table.drop_columns(["keypoints"]).append_column("keypoints", pa.array(numbers @ np.arange(1.0, 52.0)))
    columns = {}
    for name in table.column_names:
        column = table[name].combine_chunks()
        if pa.types.is_dictionary(column.type):
            column = column.dictionary_decode()
        if not pa.types.is_string(column.type):
            # Null as a number of its own.
            column = pc.fill_null(column.cast(pa.float64()), -9e99)
        columns[name] = column.to_numpy(zero_copy_only=False)
    return columns


def _compare(name, before, after):
    lost, won = certain.gained({name: after}, {name: before}), certain.gained({name: before}, {name: after})
    assert not lost and not won, (f"{name} changed elsewhere", "lost", _some(lost), "won", _some(won))


def _some(found):
    return {
        kind: [dict(zip(rows, row, strict=True)) for row in zip(*(v.tolist()[:3] for v in rows.values()), strict=True)]
        for kind, rows in found.items()
    }


def _stretches(rng, first, last, edges):
    """Frames in stretches, with gaps of all lengths between them; without `edges` none of the first and last."""
    frames, at = set(), first + (0 if edges and rng.random() < 0.5 else rng.randrange(1, 40))
    longest = rng.choice((1, 3, 20, 60, 400, 400))
    while at < last:
        end = at + rng.randrange(1, longest + 1)
        frames |= set(range(at, end))
        at = end + rng.choice((rng.randrange(1, 30), rng.randrange(30, 120)))
    return frames if edges else frames & set(range(first + 1, last))


# -- the run -------------------------------------------------------------------------------------------------------

_worlds: dict[int, World] = {}


def prepare(folder):
    """Nothing is needed beside the worlds."""


def run_case(seed, number, folder, save):
    """One case; the number of records that it changed. `save(name, bytes)` keeps the files of a failing one."""
    number_of_world = number // CASES_PER_WORLD
    if number_of_world not in _worlds:
        for world in _worlds.values():
            shutil.rmtree(world.root)
        _worlds.clear()
        _worlds[number_of_world] = World(folder, seed, number_of_world)
    case = Case(_worlds[number_of_world], Random(f"{seed} records {number}"))
    try:
        case.check(case.changes)
    except Exception as error:
        fewest = smallest(case, error)
        error.add_note(f"{len(fewest)} of {len(case.changes)} changes fail as well: {_shown(case, fewest)}")
        save("root", lambda path: case.write(fewest, path))
        raise
    return case.records


def smallest(case, error):
    """As few of a case's changes as still raise an error of the same type."""
    left, size = dict(case.changes), max(1, len(case.changes) // 2)
    end = time.monotonic() + LONGEST_SEARCH
    while time.monotonic() < end:
        keys = list(left)
        for begin in range(0, len(keys), size):
            fewer = {key: left[key] for key in keys[:begin] + keys[begin + size :]}
            if _fails(case, fewer, type(error)):
                left = fewer
                break
        else:
            if size == 1:
                break
            size = max(1, size // 2)
    return left


def _fails(case, changes, kind):
    try:
        case.check(changes)
    except Exception as error:
        return isinstance(error, kind)
    return False


def _shown(case, changes):
    files = case.world.files
    return [
        (files[n].layer, files[n].groups[g].records[r or 0], text[:300])
        for (n, g, r), text in list(changes.items())[:3]
    ]
