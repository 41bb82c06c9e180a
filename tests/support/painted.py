"""Painted panoramas: small worlds of people, a store of questions about one, its answers, and a method for them."""

import json
import shutil
from dataclasses import asdict, dataclass, field
from types import SimpleNamespace

import cv2
import numpy as np
import pyarrow as pa
import pytest

from jrdb_avr.agent.simulated.people import Person
from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.queries.manifest import Manifest, SequenceEntry
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice, Evidence
from jrdb_avr.schema.labels import INTERACTIONS
from jrdb_avr.schema.method import Prediction, Question, SequenceInfo, Task
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import LoadRules, rules_hash
from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS, QUESTIONS
from jrdb_avr.schema.wording.text import question_id, render

SEQUENCE = "painted"


LISTED = {name: frozenset() for name in ("action", "object", "interaction")}
TIES = dict.fromkeys((SAME_GROUP, *INTERACTIONS), frozenset())


@dataclass
class Actor:
    """A person: `box(frame)` is a Box or None (not there), `labels(frame)` what is annotated: values by name."""

    track: int
    box: object
    labels: object
    metres: float = 5.0
    ties: dict = field(default_factory=dict)

    def at(self, frame):
        """The person as annotated; None if not there."""
        if (box := self.box(frame)) is None:
            return None
        texts = {name: (value,) if isinstance(value, str) else value for name, value in self.labels(frame).items()}
        labels = LISTED | {name: frozenset(values) for name, values in texts.items()}
        return Person(self.track, box, labels, TIES | self.ties, self.metres)


def still(x, track, *, y=120, w=70, h=220, metres=5.0, **labels):
    """An actor that stays where it is and as it is."""
    return Actor(track, lambda frame: Box(x, y, w, h), lambda frame: labels, metres)


class EveryQuestion(dict):
    def get(self, question):
        return SEQUENCE


@dataclass
class World:
    root: object
    actors: list
    frames: tuple
    fps: float = 15.0
    painted: set = field(default_factory=set)

    def __post_init__(self):
        folder = self.root / SEQUENCE
        folder.mkdir(parents=True, exist_ok=True)
        self.info = SequenceInfo(SEQUENCE, self.fps, self.frames[-1] + 1, tuple(self.frames))
        observer = Observer(self.root, [self.info])

        def painted(frame):
            # When first looked at: worlds of many frames cost only what is seen.
            if frame not in self.painted:
                self.painted.add(frame)
                self.paint(folder / f"{frame:06d}.jpg", frame)
            return frame

        self.observe = lambda sequence, frame_index, angle_deg: observer(sequence, painted(frame_index), angle_deg)
        self.panorama = lambda sequence, frame_index: observer.stored(sequence, painted(frame_index))

    def paint(self, path, frame):
        image = np.full((HEIGHT, WIDTH, 3), 96, np.uint8)
        image[240:] = 70
        for person in self.people(SEQUENCE, frame):
            x, y, w, h = map(round, person.box)
            for left in (x - WIDTH, x, x + WIDTH):
                cv2.rectangle(image, (left, y), (left + w - 1, y + h - 1), (40 + 20 * (person.track % 8), 90, 160), -1)
        cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 90])

    def people(self, sequence, frame):
        """What the simulated model reads of a frame, as `Sight` does."""
        return [person for actor in self.actors if (person := actor.at(frame)) is not None]

    @property
    def sequences(self):
        """Every question is about this world."""
        return EveryQuestion()

    def task(self, question, mode, choices=(), steps=None, writes=None):
        row = Question("0" * 16, SEQUENCE, question, tuple(choices), mode)
        record = (steps if steps is not None else []).append
        return Task(row, self.info, self.observe, self.panorama, record, ([] if writes is None else writes).append)


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


EMPTY = {"string": "", "bool": False}


def table_of(schema, rows):
    """A table of rows that name the columns that matter."""
    plain = {field.name: None if field.nullable else EMPTY.get(str(field.type), 0) for field in schema}
    return pa.Table.from_pylist([plain | row for row in rows], schema)


def write_annotations(store, actors, sequence=SEQUENCE, frames=FRAMES):
    """The tables that the simulated model reads; returns the manifest's entry."""
    layers = ("2d", "actions", "interactions", "handles")
    people = [(frame, one) for frame in frames for actor in actors if (one := actor.at(frame)) is not None]
    frames = [{"layer": layer, "frame": frame} for layer in layers for frame in frames]
    listed = dict.fromkeys(("listed", "interactions_listed", "handles_listed"), True)
    sightings = [
        {"frame": frame, "track": one.track, "distance": one.metres, **one.box._asdict(), **listed}
        for frame, one in people
    ]
    actions = [
        {"frame": frame, "track": one.track, "action": label}
        for frame, one in people
        for name in ("pose", "action")
        for label in one.labels.get(name, ())
    ]
    for name, rows in {"frames": frames, "actions": actions, "interactions": (), "handles": ()}.items():
        store.write_annotation(name, sequence, table_of(ANNOTATIONS[name], rows))
    for name, rows in {"sightings": sightings, "objects": (), "demographics": ()}.items():
        store.write_interval(name, sequence, table_of(INTERVALS[name], rows))
    return SequenceEntry(layers, {})


def write_store(path, image_root, questions=(*QUESTIONS_ASKED, BLIND), names=(SEQUENCE,)):
    """A store with the public files, and sequences of these names with the annotations of the questions' world."""
    store = Store(path)
    rules = LoadRules()
    entries = {name: write_annotations(store, asked_actors(), name) for name in names}
    store.write_manifest(Manifest(str(image_root), rules, rules_hash(rules), entries, {}))
    write_public(store, questions, {SEQUENCE: FRAMES, "unseen": FRAMES})
    return store


@pytest.fixture(scope="session")
def asked_world(once):
    """The folders `store` and `images`, made once; not to be written to."""
    return once("asked", make_asked_world)


def asked_actors():
    """The people of the questions' world: one who changes, and one who does not."""

    def labels(frame):
        return {"pose": "standing" if frame < 60 else "sitting" if frame < 120 else "lying"}

    changing = Actor(7, lambda frame: Box(*box_at(frame)), labels, 4.0)
    return [changing, still(900, 8, pose="walking")]


def asked_people(root):
    """The world of the questions."""
    return World(root, asked_actors(), FRAMES)


def asked_sight():
    """What the simulated model reads of the questions' world, under any name."""

    def people(sequence, frame):
        return [person for actor in asked_actors() if (person := actor.at(frame)) is not None]

    return SimpleNamespace(people=people, sequences=EveryQuestion())


def make_asked_world(root):
    world = asked_people(root / "images")
    for frame in FRAMES:
        world.paint(root / "images" / SEQUENCE / f"{frame:06d}.jpg", frame)
    write_store(root / "store", root / "images")


@pytest.fixture
def store(asked_world, tmp_path):
    """A copy of the store, for a test's own runs."""
    shutil.copytree(asked_world / "store", tmp_path / "store")
    return Store(tmp_path / "store")


def asked_frame(question):
    return int(question.question.rpartition("(frame ")[2].partition(")")[0])


def shown_at(frame):
    return POSES.index("sitting" if frame < 120 else "lying") + 1


def box_at(frame):
    return (3650 + frame * 0.5, 120.0, 70.0, 220.0)


def write_answers(store, questions=QUESTIONS_ASKED):
    """Answers under which every second question's reading is right, and evidence where the person stands."""
    answers, evidence = [], {}
    for i, q in enumerate(questions):
        frame = asked_frame(q)
        answer = json.dumps({"choice": shown_at(frame) if i % 2 else shown_at(frame) % 4 + 1})
        texts = dict.fromkeys(("plan", "rules", "bindings", "needed", "proofs"), "{}")
        numbers = {"target_track": 1, "hops": 1, "time_gap_s": 1.0, "separation_deg": 1.0, "people_in_scene": 2}
        answers.append({"question_id": q.question_id, "answer": answer, **texts, **numbers})
        box = dict(zip("xywh", box_at(frame), strict=True))
        evidence[q.sequence, frame] = {"sequence": q.sequence, "track": 1, "frame": frame, **box}
    store.write_questions("answers", pa.Table.from_pylist(answers, QUESTIONS["answers"]), {})
    rows = store.questions("questions").filter(pa.compute.field("sequence") != "unseen")
    store.write_questions("questions", rows, {})
    store.write_questions("evidence", pa.Table.from_pylist([*evidence.values()], QUESTIONS["evidence"]), {})


class Reader:
    """A method that knows the questions' people without looking."""

    name = "reader"

    def answer(self, task):
        t1 = asked_frame(task.question)
        return Prediction("answered", Choice(shown_at(t1)), Evidence(t1, box_at(t1)))
