"""People with labels, and random worlds of walking people with noisy readings of them, without pictures."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass
from typing import NamedTuple

import pyarrow as pa

from jrdb_avr.agent.look.attention import next_looks
from jrdb_avr.agent.look.ranking import rank
from jrdb_avr.agent.perceive.geometry import SeenColumns, first_beside, seen_from
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel
from jrdb_avr.agent.perceive.votes import Tracks
from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.loaders.intervals.derive import derive
from jrdb_avr.schema.labels import AGES, GENDERS, answer_of_choice, may_be_called
from jrdb_avr.schema.panorama import WIDTH, Box, angle_error, angle_of_azimuth, column_of_angle
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_LEFT
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.templates import TEMPLATES, Slots

RULES = Rules()
SEQUENCE = "world"
EASY, HARD = 1, 3
CATEGORIES = {57: "shelf", 40: "accessory", 63: "pedestrian", 900: None}


class World:
    """Annotation tables of one sequence. Layers beyond boxes and actions are there once something is written."""

    def __init__(self, frames, attributes=True, images=None):
        self.frames = list(frames)
        self.attributes = attributes
        self.images = images
        self.action_frames = set(self.frames)
        self.group_frames = self.frames
        self.rows = {name: [] for name in ANNOTATIONS}
        self.more = set()

    def see(self, track, frames, actions=("standing",), *, x=1880.0, w=50, h=150, y=100, occlusion="Fully_visible",
            no_eval=False, group=None, at=None, points=50, heading=0.0):  # fmt: skip
        """The person has this box, these actions (name, or name and difficulty) and this place at the frames.

        at: metres ahead of the robot, to its left and, if need be, up; heading: degrees to the left of its own.
        """
        for frame in frames:
            where = {"sequence": SEQUENCE, "frame": frame, "track": track}
            self.rows["boxes_2d"].append(
                where
                | {"x": float(x), "y": float(y), "w": float(w), "h": float(h)}
                | {"has_attributes": self.attributes, "has_actions": actions is not None, "no_eval": no_eval}
                | {"occlusion": occlusion if self.attributes else None}
            )
            for action in actions or ():
                name, difficulty = action if isinstance(action, tuple) else (action, EASY)
                self.rows["actions"].append(where | {"action": name, "raw": name, "difficulty": difficulty})
            if group is not None:
                cluster, difficulty = group if isinstance(group, tuple) else (group, EASY)
                self.rows["groups"].append(where | {"cluster": cluster, "difficulty": difficulty})
                self.more.add("groups")
            if at is not None:
                forward, left, up = (*at, 0.0)[:3]
                place = {"cx": float(forward), "cy": float(left), "cz": float(up), "l": 1.0, "w": 1.0, "h": 1.8}
                turned = {"rot_z": math.pi - math.radians(heading), "num_points": points}
                self.rows["boxes_3d"].append(where | place | turned)
        return self

    def show(self, actions, occlusion="Fully_visible"):
        """In the last frame each of these actions is done by another person."""
        for action in actions:
            track = 900 + len(self.rows["boxes_2d"])
            self.see(track, self.frames[-1:], [action], x=track % 60 * 60, occlusion=occlusion)
        return self

    def list(self, tracks, frames, layer="interactions"):
        """The whole lists of these people could be read: they have no interactions (or things) but those written."""
        for frame in frames:
            for track in tracks:
                self.rows["listed"].append({"sequence": SEQUENCE, "layer": layer, "frame": frame, "track": track})
        self.more.add(layer)
        return self

    def join(self, track, partner, frames, label="conversation"):
        """The person's labels say that it is in an interaction with the partner."""
        self._write("interactions", track, frames, [("label", label)], partner=partner)
        return self

    def handle(self, track, frames, verb, category, thing=1):
        """The person does something with a thing of the category of this number."""
        self._write("handles", track, frames, [("verb", verb)], object=thing, category_id=category)
        return self

    def _write(self, layer, track, frames, facts, **more):
        self.more.add(layer)
        for frame in frames:
            for column, said in facts:
                name, difficulty = said if isinstance(said, tuple) else (said, EASY)
                row = {"sequence": SEQUENCE, "frame": frame, "track": track, column: name, "difficulty": difficulty}
                self.rows[layer].append(row | {"raw": str(name)} | more)

    def read(self, rules=RULES):
        """The tables as the second path has them."""
        return Annotations(self.tables(), rules)

    def tables(self):
        """The annotation tables, each in the order in which its rows were written."""
        layers = {"2d": self.frames, "actions": sorted(self.action_frames)}
        layers |= dict.fromkeys(sorted(self.more), self.frames)
        if "groups" in layers:
            layers["groups"] = self.group_frames
        if self.images is not None:
            layers["images"] = self.images
        for layer, frames in layers.items():
            self.rows["frames"] += [
                {"sequence": SEQUENCE, "layer": layer, "frame": frame, "records": 1} for frame in frames
            ]
        self.rows["categories"] = [
            {"sequence": SEQUENCE, "category_id": number, "category": name, "raw": name or "teapot"}
            for number, name in CATEGORIES.items()
        ]
        return {name: pa.Table.from_pylist(self.rows[name], schema) for name, schema in ANNOTATIONS.items()}


def intervals_of(world, rules):
    """The interval tables of a world, by name."""
    order = [("frame", "ascending"), ("track", "ascending")]
    tables = {
        name: table.sort_by(order) if "track" in table.column_names else table for name, table in world.tables().items()
    }
    return derive(SEQUENCE, tables, rules)


def toward(degrees, w=50):
    """The left edge of a box of this width whose centre lies in this direction."""
    return degrees / 360 * 3760 - w / 2


def at_t0(**kwargs):
    """A condition at t0."""
    return Condition(at="t0", **kwargs)


CHOICES = ("walking", "standing", "sitting", "lying down")


def ask(world, form, conditions, frames, action=None, rules=RULES, actions=(), relations=(), choices=CHOICES,
        shown=None):  # fmt: skip
    """What the second path finds for a question of a form of the wording's table; somebody does what choices say."""
    row = TEMPLATES[form]
    if row.asks_action:
        world.show([answer_of_choice(choice) for choice in (choices if shown is None else shown)])
    times = dict(zip(row.stated, frames, strict=True))
    named = (action,) if action else tuple(actions)
    plan = row.build(Slots(tuple(conditions), times, named, tuple(relations)))
    return rederive(world.read(rules), plan, row.name, rules, choices)


POSES = ("walking", "standing", "sitting")
VALUES = {"gender": GENDERS, "age": AGES, "action": POSES}


@dataclass(frozen=True)
class Noise:
    """wrong: per attribute; wrong_box, miss: per person and picture; jitter: of a box's sides, as a share of them."""

    wrong: float = 0.0
    wrong_box: float = 0.0
    miss: float = 0.0
    jitter: float = 0.03


class ReadWorld:
    """People by name, each with attributes and a place in metres at every frame.

    later: who takes another pose at a frame; away: who is not there between two frames.
    """

    def __init__(self, rng, people=8, frames=300):
        self.rng = rng
        self.names = [f"t{n}" for n in range(people)]
        self.values = {who: {name: rng.choice(words) for name, words in VALUES.items()} for who in self.names}
        self.later = {}
        self.away = {}
        self.places = {who: self._walk(frames) for who in self.names}

    def _walk(self, frames):
        rng = self.rng
        angle, metres = rng.uniform(0, 2 * math.pi), rng.uniform(2, 9)
        x, y = metres * math.cos(angle), metres * math.sin(angle)
        speed, heading, places = rng.choice((0.0, 0.0, 0.6, 1.2)), rng.uniform(0, 2 * math.pi), []
        for frame in range(frames):
            if frame % 45 == 44:
                heading, speed = heading + rng.gauss(0, 0.5), rng.choice((speed, speed, 0.0, 1.2))
            step = speed / 15
            # Nobody walks through the robot.
            if math.hypot(x + step * math.cos(heading), y + step * math.sin(heading)) < 1.5:
                heading += math.pi
            x, y = x + step * math.cos(heading), y + step * math.sin(heading)
            places.append((x, y))
        return places

    def angle(self, who, frame):
        x, y = self.places[who][frame]
        return angle_of_azimuth(math.atan2(y, x))

    def box(self, who, frame):
        height = min(480 * 1.7 / math.hypot(*self.places[who][frame]), 400.0)
        width = 0.4 * height
        return Box(column_of_angle(self.angle(who, frame)) - width / 2, 220 - 0.45 * height, width, height)

    def read(self, who, frame, observation, number, noise):
        rng, box = self.rng, self.box(who, frame)
        if rng.random() < noise.wrong_box:
            box = box._replace(x=box.x + rng.choice((-1, 1)) * rng.uniform(1, 4) * box.w)
        sides = [side * (1 + rng.gauss(0, noise.jitter)) for side in (box.w, box.h)]
        box = Box(box.x + rng.gauss(0, noise.jitter) * box.w, box.y, *sides)
        labels = tuple(ReadLabel(name, self._value(who, name, frame, noise)) for name in VALUES)
        return PersonReading(observation, number, frame, box, labels)

    def value(self, who, name, frame):
        change, pose = self.later.get(who, (math.inf, ""))
        return pose if name == "action" and frame >= change else self.values[who][name]

    def _value(self, who, name, frame, noise):
        rng, true = self.rng, self.value(who, name, frame)
        others = [word for word in VALUES[name] if word != true]
        return rng.choice(others) if rng.random() < noise.wrong else true

    def picture(self, frame, angle, noise, observation="o"):
        """The people read in a look, and their names; whoever stands in its inner 44 degrees."""
        there = [who for who in self.names if angle_error(self.angle(who, frame), angle) < 22]
        there = [who for who in there if not self.away.get(who, (1, 0))[0] <= frame <= self.away.get(who, (1, 0))[1]]
        there = [who for who in there if self.rng.random() >= noise.miss]
        return [self.read(who, frame, observation, n, noise) for n, who in enumerate(there)], there

    def read_round(self, times, noise):
        """The tracks after everybody was read so many times at `FRAME`."""
        people = {
            who: tuple(self.read(who, FRAME, f"o{k}", n, noise) for k in range(times))
            for n, who in enumerate(self.names)
        }
        looks = [seen_from(angle) for _ in range(times) for angle in range(0, 360, 40)]
        return Tracks(people, {FRAME: tuple(looks)})

    def explored(self, plan, noise, looks=24):
        """Look as attention says: the tracks, the looks and the entity taken for the target."""
        tracks, made = Tracks({}, {}), []
        frames = range(len(next(iter(self.places.values()))))
        while advised := next_looks(plan, tracks, rank(plan, tracks), looks - len(made), frames):
            look = advised[0]
            readings, names = self.picture(look.frame, look.angle, noise, f"o{len(made)}")
            tracks = tracks.with_people(seen_from(look.angle), look.frame, list(zip(names, readings, strict=True)))
            made.append(look)
        return tracks, made, self.found(plan, tracks)

    def found(self, plan, tracks):
        """The name of the person whom the best hypothesis takes for the target."""
        ranked = rank(plan, tracks)
        return ranked[0].nodes.get(plan.target) if ranked else None


# -- finding the person of a plan -------------------------------------------------------------------------------------

FRAME = 15


class Identified(NamedTuple):
    """Shares of worlds in which the plan's target is found, by all readings and by each person's newest one."""

    votes: float
    newest: float


def identified(seeds, readings, noise, people=8):
    """How often the target of a random plan is found after each person was read so many times."""
    votes = newest = 0
    for seed in seeds:
        world = ReadWorld(random.Random(seed), people)
        plan, target = asked_of(world)
        tracks = world.read_round(readings, noise)
        # As one look all round would show them: a reading that was dropped is no look that failed to show somebody.
        last = Tracks({who: read[-1:] for who, read in tracks.people.items()}, {FRAME: (SeenColumns(0, WIDTH),)})
        votes += world.found(plan, tracks) == target
        newest += world.found(plan, last) == target
    return Identified(votes / len(seeds), newest / len(seeds))


def asked_of(world):
    """A plan whose description fits one person alone, with one hop where it leads to one person; and the target."""
    boxes = {who: world.box(who, FRAME) for who in world.names}
    looks = [SeenColumns(0, WIDTH)]
    while True:
        for who in world.rng.sample(world.names, len(world.names)):
            for names in itertools.chain(itertools.combinations(VALUES, 2), [(*VALUES,)]):
                if any(all(_may_fit(world, o, who, n) for n in names) for o in world.names if o != who):
                    continue
                conditions = tuple(_condition(name, world.values[who][name]) for name in names)
                nexts = [o for o in world.names if o != who and first_beside(boxes, who, "left", looks)[o]]
                if nexts and world.rng.random() < 0.5:
                    edges = (Edge("a", FIRST_LEFT, "b", "t0"),)
                    return _plan((Node("a", conditions), Node("b")), edges), nexts[0]
                return _plan((Node("a", conditions),), ()), who
        # Nobody is unlike all others.
        world.values[world.names[0]] = {name: world.rng.choice(words) for name, words in VALUES.items()}


def _may_fit(world, other, who, name):
    """Whether the value of one person may be said of another."""
    own, value = world.values[other][name], world.values[who][name]
    return own == value or own in may_be_called(value)


def _condition(name, value):
    return Condition(action=value, at="t0") if name == "action" else Condition(attribute=name, value=value)


def _plan(nodes, edges):
    answer = AnswerSpec("multiple_choice", "action", nodes[-1].id, "t0")
    return Plan("a", nodes[-1].id, {"t0": Time(frame=FRAME)}, nodes, edges, answer)


WOMAN = Plan(
    "a",
    "a",
    {"t0": Time(frame=15)},
    (Node("a", (Condition(attribute="gender", value="female"),)),),
    (),
    AnswerSpec("multiple_choice", "action", "a", "t0"),
)
"""Of the only woman, asked for what she does at frame 15."""


def reading_at(plan, read, mode, *frames, **event):
    """The same plan with another read: at stated frames, or at an event of the target after the description."""
    times = {f"t{n}": Time(frame=frame) for n, frame in enumerate(frames, start=1)}
    if event:
        times["t1"] = Time(of=plan.target, after="t0", **event)
    at = "t1" if len(times) == 1 else tuple(times)
    answer = AnswerSpec(mode, read, plan.target, at)
    return Plan(plan.root, plan.target, {**plan.times, **times}, plan.nodes, plan.edges, answer)
