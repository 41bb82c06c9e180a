"""Games of the reference agent: scripted replies on grey pictures, with a real world model or none."""

import itertools
import json
from types import SimpleNamespace

import numpy as np

from jrdb_avr.agent.model.messages import Picture
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.schema.method import Observation, Panorama, Question, SequenceInfo, Task
from jrdb_avr.schema.panorama import CROP, FOV_DEG, crop_left

CHOICES = ("walking", "standing", "sitting", "lying down")
FRAMES = tuple(range(0, 300, 5))
MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")

PLAN = {
    "root": "a",
    "target": "a",
    "times": {"t0": {"frame": 150}},
    "nodes": [{"id": "a", "conditions": [{"attribute": "gender", "value": "female"}]}],
    "edges": [],
    "answer": {"mode": "multiple_choice", "read": "action", "of": "a", "at": "t0"},
}
_STARTS = {"t0": {"frame": 150}, "t1": {"event": "start", "of": "a", "action": "walking", "after": "t0"}}
_ENDS = _STARTS | {"t2": {"event": "end", "of": "a", "action": "walking", "after": "t1"}}
PLANS = {
    "multiple_choice": PLAN,
    "frame": PLAN | {"times": _STARTS, "answer": {"mode": "frame", "read": "start", "of": "a", "at": "t1"}},
    "span": PLAN | {"times": _ENDS, "answer": {"mode": "span", "read": "span", "of": "a", "at": ["t1", "t2"]}},
    "frame_viewpoint": PLAN
    | {"times": _STARTS, "answer": {"mode": "frame_viewpoint", "read": "start_view", "of": "a", "at": "t1"}},
    "number": PLAN
    | {
        "times": {"t0": {"frame": 150}, "t1": {"frame": 240}},
        "answer": {"mode": "number", "read": "count", "of": "a", "at": ["t0", "t1"], "relation": "conversation"},
    },
}
PAIR = PLAN | {
    "target": "b",
    "nodes": [*PLAN["nodes"], {"id": "b", "conditions": []}],
    "edges": [{"source": "a", "relation": "conversation", "target": "b", "at": "t0"}],
    "answer": PLAN["answer"] | {"of": "b"},
}

LEFT_BOX, RIGHT_BOX = [100, 250, 250, 700], [600, 250, 750, 700]
GRAPH = {"tool": "get_graph"}
ADVISED = {"tool": "observe"}


def turn(*calls):
    return json.dumps({"calls": list(calls)})


def look(frame=150, angle=180.0):
    return {"tool": "observe", "frame_id": f"{frame:06d}", "angle_deg": angle}


def people(*persons, observation="o1"):
    return {"tool": "add_people", "observation": observation, "people": list(persons)}


def entity(name="p1", observation="o1", box=LEFT_BOX):
    return {"tool": "add_entity", "id": name, "observation": observation, "box": list(box)}


def attribute(name, value, entity="p1", observation="o1"):
    return {"tool": "add_attribute", "entity": entity, "name": name, "value": value, "observation": observation}


def relation(name="relation conversation", source="p1", target="p2", observation="o1"):
    return {"tool": "add_relation", "source": source, "name": name, "target": target, "observation": observation}


def final(answer=2, entity="p1"):
    return {"tool": "final_answer", "answer": answer, "entity": entity}


def chat_final(answer=2, observation="o1", box=LEFT_BOX):
    """The final answer of a variant without a world model."""
    return {"tool": "final_answer", "answer": answer, "observation": observation, "box": list(box)}


class Scripted:
    """A model with a script of replies. The last reply repeats. A reply may be a function of the messages."""

    def __init__(self, replies):
        self.replies, self.requests, self.schemas = list(replies), [], []

    def complete(self, messages, schema=None):
        said = self.replies[min(len(self.requests), len(self.replies) - 1)]
        self.requests.append(list(messages))
        self.schemas.append(schema)
        if callable(said):
            said = said(text_of(messages))
        if isinstance(said, Reply):
            return said
        return Reply(said if isinstance(said, str) else json.dumps(said), finish_reason="stop", prompt_tokens=10)


def text_of(messages):
    return "\n".join("[image]" if isinstance(part, Picture) else part for m in messages for part in m.parts)


def pictures_of(messages):
    return [part.name for m in messages for part in m.parts if isinstance(part, Picture)]


def line_of(text, name):
    """The JSON of a line of a turn, such as `World`."""
    (line,) = (line for line in text.split("\n") if line.startswith(f"{name}: "))
    return json.loads(line.removeprefix(f"{name}: "))


def results_of(text):
    lines = text.rpartition("Results:\n")[2].split("\n")
    return [line.partition(". ")[2] for line in lines if line[:1].isdigit()]


def form_of(text, **values):
    """A person with every field of the line `Fields`: the given values, else no information."""
    empty = {"ids of people": None, "number": None}
    fields = line_of(text, "Fields")
    return {key: values.get(key, empty.get(str(form), "cannot tell")) for key, form in fields.items()}


def person(name="p1", box=LEFT_BOX, **values):
    """A function that returns a person as a turn asks for it."""
    return lambda text: {"id": name, "box": list(box), **form_of(text, **values)}


def writes(*persons, observation="o1", then=()):
    """A reply that writes people and makes further calls."""
    return lambda text: turn(people(*(one(text) for one in persons), observation=observation), *then)


WOMAN = person("p1", gender="female", pose="standing")
MAN = person("p2", RIGHT_BOX, gender="male", pose="sitting")


def _observe(sequence, frame_index, angle_deg):
    angle = angle_deg % 360.0
    image = np.zeros((CROP, CROP, 3), np.uint8)
    left = int(crop_left(angle))
    return Observation(sequence, frame_index, frame_index / 15, angle, FOV_DEG, left, image)


def _panorama(sequence, frame_index):
    return Panorama(sequence, frame_index, frame_index / 15, b"jpeg")


def task_of(mode="multiple_choice", question="What does the woman do?", steps=None, writes=None, name="0" * 16):
    row = Question(name, "s", question, CHOICES if mode == "multiple_choice" else (), mode)
    info = SequenceInfo("s", 15.0, FRAMES[-1] + 1, FRAMES)
    record, record_write = ([] if rows is None else rows for rows in (steps, writes))
    return Task(row, info, _observe, _panorama, record.append, record_write.append)


_names = itertools.count()


def play(replies, mode="multiple_choice", *, world=None, name=None, **options):
    """A game: its prediction, requests, schemas, steps and writes. Each game is a question of its own by default."""
    name = name or f"{next(_names):016x}"
    chat, steps, writes = Scripted(replies), [], []
    agent = ReferenceAgent(chat, world=world, **options)
    prediction = agent.answer(task_of(mode, steps=steps, writes=writes, name=name))
    return SimpleNamespace(
        prediction=prediction, requests=chat.requests, schemas=chat.schemas, steps=steps, writes=writes
    )
