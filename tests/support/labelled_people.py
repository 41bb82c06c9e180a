"""Annotation tables written person by person, for tests of the second path that a person can work out.

    world = World(range(15, 601, 15)).see(1, [15, 30], ["sitting"], x=100)
    ask(world, "change", [at_t0(action="sitting")], [15, 60]).answer

Angles: a box stands in the direction of its centre, 3760 columns for 360 degrees; `toward` gives the left edge.
"""

from __future__ import annotations

import math

import pyarrow as pa

from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.templates import TEMPLATES, Slots

RULES = Rules()
SEQUENCE = "world"
EASY, MIDDLE, HARD = 1, 2, 3
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

    def tell(self, track, frames, **values):
        """Gender or age of a person as frames say it: a value, or a value and a difficulty."""
        self._write("demographics", track, frames, [("attribute", name, value) for name, value in values.items()])
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
        self._write("interactions", track, frames, [("label", label, label)], partner=partner)
        return self

    def handle(self, track, frames, verb, category, thing=1):
        """The person does something with a thing of the category of this number."""
        self._write("handles", track, frames, [("verb", verb, verb)], object=thing, category_id=category)
        return self

    def show_face(self, track, frames, seen=True):
        """Whether the person's head is marked visible at the frames."""
        points = [0.0, 0.0, 2.0 if seen else 1.0] * 3 + [0.0, 0.0, 2.0 if not seen else 0.0] * 14
        for frame in frames:
            self.rows["poses"].append({"sequence": SEQUENCE, "frame": frame, "track": track, "keypoints": points})
        self.more.add("pose")
        return self

    def _write(self, layer, track, frames, facts, **more):
        self.more.add(layer)
        for frame in frames:
            for column, name, said in facts:
                value, difficulty = said if isinstance(said, tuple) else (said, EASY)
                name, difficulty = name if isinstance(name, tuple) else (name, difficulty)
                row = {"sequence": SEQUENCE, "frame": frame, "track": track, column: name, "difficulty": difficulty}
                told = {"value": value, "raw": str(value)} if layer == "demographics" else {"raw": str(name)}
                self.rows[layer].append(row | told | more)

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


def toward(degrees, w=50):
    """The left edge of a box of this width whose centre lies in this direction."""
    return degrees / 360 * 3760 - w / 2


def at_t0(**kwargs):
    """A condition at t0."""
    return Condition(at="t0", **kwargs)


def ask(world, form, conditions, frames, action=None, rules=RULES, actions=(), relations=()):
    """What the second path finds for a question of a form of the wording's table."""
    row = TEMPLATES[form]
    times = dict(zip(row.stated, frames, strict=True))
    named = (action,) if action else tuple(actions)
    plan = row.build(Slots(tuple(conditions), times, named, tuple(relations)))
    return rederive(world.read(rules), plan, row.name, rules)
