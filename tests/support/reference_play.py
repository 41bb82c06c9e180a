"""Games of the reference agent: scripted replies, a real world model, and a solver that says what it is told to."""

import json
from dataclasses import dataclass
from types import SimpleNamespace

from jrdb_avr.agent.beliefs.solver import Belief, BeliefSolver, beliefs_of
from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.model.messages import Picture
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.queries.compiler.find import compile_find

CHOICES = ("walking", "standing", "sitting", "lying")

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


def turn(*calls):
    """A reply with these calls."""
    return json.dumps({"calls": list(calls)})


def look(frame=150, angle=180.0):
    return {"tool": "observe", "frame_id": f"{frame:06d}", "angle_deg": angle}


def entity(name="p1", observation="o1", box=(427, 250, 573, 708), **more):
    return {"tool": "add_entity", "id": name, "kind": "person", "observation": observation, "box": list(box), **more}


def attribute(name, value, entity="p1", observation="o1"):
    return {"tool": "add_attribute", "entity": entity, "name": name, "value": value, "observation": observation}


def final(answer=2, entity="p1"):
    return {"tool": "final_answer", "answer": answer, "entity": entity}


def proposed(answer=2, observation="o1", box=(427, 250, 573, 708)):
    """The final answer of a variant without a world model."""
    return {"tool": "final_answer", "answer": answer, "observation": observation, "box": list(box)}


GRAPH = {"tool": "get_graph"}


class Scripted:
    """A model that says what its script says; the last line repeats. `requests` holds the messages of each call."""

    def __init__(self, replies):
        self.script = replies if callable(replies) else lambda n: replies[min(n, len(replies) - 1)]
        self.requests = []
        self.schemas = []

    def complete(self, messages, schema=None):
        said = self.script(len(self.requests))
        self.requests.append(list(messages))
        self.schemas.append(schema)
        if isinstance(said, Reply):
            return said
        return Reply(said if isinstance(said, str) else json.dumps(said), finish_reason="stop", prompt_tokens=10)


def text_of(messages):
    """All text of messages, pictures as `[image]`."""
    return "\n".join("[image]" if isinstance(part, Picture) else part for m in messages for part in m.parts)


def pictures_of(messages):
    return [part.name for m in messages for part in m.parts if isinstance(part, Picture)]


NOBODY = Belief("empty", missing=("a: not found",))


@dataclass
class StubSolver:
    """`belief` is what the beliefs come to, `lacking` why no final answer is legal, `box` that of the best guess."""

    belief: Belief = NOBODY
    lacking: str = "a: not found"
    box: object = None

    def check(self, plan):
        compile_find(plan)

    def weigh(self, plan, rows):
        return self.belief

    def solve(self, plan, rows):
        return self.belief

    def placements(self, plan, rows, anywhere):
        return [plan]

    def guess(self, plan, rows, entity=""):
        return None if self.box is None else Belief("unknown", {"a": "p1"}, seen=self.box)

    def prior(self, plan, belief):
        return BeliefSolver(None, "", CHOICES).prior(plan, belief)

    def answer(self, plan, belief):
        return BeliefSolver(None, "", CHOICES).answer(plan, belief)

    def fault(self, plan, belief, proposed, entity):
        return self.lacking


def defined(answer="standing", seen=(150, (1800.0, 120.0, 70.0, 220.0))):
    """A solver that has found everything."""
    belief = Belief("defined", {"a": "p1"}, {"t0": 150}, answer, seen, ())
    return StubSolver(belief, lacking="")


def play(
    world, replies, mode="multiple_choice", *, graph=None, solver=None, question="What does the person do?", **options
):
    """A game in a painted world: its prediction, requests, steps and writes.

    graph: the world model's, None without; solver: what it is told to say, or "real".
    """
    chat = Scripted(replies)
    steps, writes = [], []
    solver = solver or StubSolver()
    solving = beliefs_of if solver == "real" else lambda world, question: solver
    memory = None if graph is None else WorldModel(graph, "run")
    agent = ReferenceAgent(chat, world=memory, solving=solving, **options)
    task = world.task(question, mode, CHOICES if mode == "multiple_choice" else (), steps, writes)
    prediction = agent.answer(task)
    return SimpleNamespace(
        prediction=prediction, requests=chat.requests, schemas=chat.schemas, steps=steps, writes=writes
    )
