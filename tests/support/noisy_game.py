"""One game of the policy `driven` with a noisy simulated model, printed step by step; run in a process of its own."""

import json
import sys
import tempfile
from pathlib import Path

import msgspec
from painted import World, still

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.model.messages import wire
from jrdb_avr.agent.model.reply import Reply, read_completion
from jrdb_avr.agent.reference.episode import Limits
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.agent.simulated.knobs import Knobs
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.queries.beliefs.graph import WorldGraph

PEOPLE = [
    (1845, "sitting", "reading"),
    (1700, "standing", "typing"),
    (300, "standing", "typing"),
    (2900, "walking", ""),
]
PLAN = {
    "root": "a",
    "target": "b",
    "times": {"t0": {"frame": 30}, "t1": {"frame": 60}},
    "nodes": [
        {"id": "a", "conditions": [{"action": "reading", "at": "t0"}]},
        {"id": "b"},
        {"id": "c"},
    ],
    "edges": [
        {"source": "a", "relation": "conversation", "target": "b", "at": "t0"},
        {"source": "b", "relation": "in the same group as", "target": "c", "at": "t0"},
    ],
    "answer": {"mode": "multiple_choice", "read": "action", "of": "b", "at": "t1"},
}
KNOBS = Knobs(wrong_attribute=0.2, confuse=0.3, correlated=0.5, ids=False, ghosts=0.2, please=0.3, seed=3)


class Model:
    """Plans by `PLAN` and reads pictures as the simulated model does."""

    def __init__(self):
        self.server, self.asked = Server(knobs=KNOBS), 0

    def complete(self, messages, schema=None):
        self.asked += 1
        if self.asked == 1:
            return Reply(json.dumps(PLAN), finish_reason="stop")
        body = json.dumps({"messages": wire(messages)}).encode()
        return read_completion(json.dumps(self.server.reply(body)).encode())


def main():
    actors = [
        still(x, n, gender="female", age="young adulthood", pose=pose, actions=(action,) * bool(action))
        for n, (x, pose, action) in enumerate(PEOPLE, 7)
    ]
    steps, writes = [], []
    with tempfile.TemporaryDirectory() as folder, WorldGraph.memory() as graph:
        task = World(Path(folder), actors, tuple(range(0, 91, 15))).task(
            "Who?", "multiple_choice", ("sitting", "standing", "walking"), steps, writes
        )
        world = WorldModel(graph, "run")
        prediction = ReferenceAgent(Model(), world=world, policy="driven", limits=Limits(looks=8)).answer(task)
    lines = [[step.kind, step.request, step.response] for step in steps]
    sys.stdout.buffer.write(msgspec.json.encode([*lines, *writes, prediction]))


if __name__ == "__main__":
    main()
