"""A painted sequence, questions about it, and a store that holds the public files alone: what runs are tried on."""

import shutil
from dataclasses import asdict

import pyarrow as pa
import pytest
from painted_world import SEQUENCE, Actor, World, still

from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.method import Question
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time
from jrdb_avr.schema.rules import LoadRules, rules_hash
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.wording.text import question_id, render

LABELS = {"family": "unique_anchor", "template": "change"}
POSES = ("walking", "sitting", "standing", "lying")
FRAMES = tuple(range(0, 301, 15))


def question(t0, t1, sequence=SEQUENCE):
    conditions = (Condition(action="standing", at="t0"),)
    spec = AnswerSpec(mode="multiple_choice", read="action", of="a", at="t1")
    times = {"t0": Time(frame=t0), "t1": Time(frame=t1)}
    plan = Plan("a", "a", times, (Node("a", conditions),), (), spec)
    text = render("change", plan, "0" * 64)
    public = (sequence, *LABELS.values(), text, POSES, "multiple_choice")
    return Question(question_id(*public), sequence, text, POSES, "multiple_choice")


QUESTIONS_ASKED = [question(t0, t1) for t0 in (0, 15, 30) for t1 in (90, 105, 150, 300)]
BLIND = question(0, 90, "unseen")


def write_public(store, questions, frames):
    """The public files: questions, and the frames of their sequences."""
    rows = [{**asdict(q), **LABELS, "choices": list(q.choices)} for q in questions]
    store.write_questions("questions", pa.Table.from_pylist(rows, QUESTIONS["questions"]), {})
    rows = [{"sequence": name, "fps": 15.0, "frame_count": 301, "frames": list(f)} for name, f in frames.items()]
    store.write_questions("sequences", pa.Table.from_pylist(rows, QUESTIONS["sequences"]), {})


def write_store(path, image_root, questions=(*QUESTIONS_ASKED, BLIND)):
    """A store with the public files alone."""
    store = Store(path)
    rules = LoadRules()
    store.write_manifest(Manifest(str(image_root), rules, rules_hash(rules), {}, {}))
    write_public(store, questions, {SEQUENCE: FRAMES, "unseen": FRAMES})
    return store


@pytest.fixture(scope="session")
def asked_world(once):
    """The folders `store` and `images`, made once; not to be written to."""
    return once("asked", make_asked_world)


def make_asked_world(root):
    def box(frame):
        return Box(3650 + frame * 0.5, 120, 70, 220)

    def mark(frame):
        return Mark(7, pose="standing" if frame < 60 else "sitting" if frame < 120 else "lying", distance_dm=40)

    world = World(root / "images", [Actor(box, mark), still(900, 8, pose="walking")], FRAMES)
    for frame in FRAMES:
        world.paint(root / "images" / SEQUENCE / f"{frame:06d}.jpg", frame)
    write_store(root / "store", root / "images")


@pytest.fixture
def store(asked_world, tmp_path):
    """A copy of the store, for a test's own runs."""
    shutil.copytree(asked_world / "store", tmp_path / "store")
    return Store(tmp_path / "store")
