"""Service time of the world model: `python tests/benchmarks/bench_world.py`.

64 episodes are in flight in one process, over 20,000 entities of older runs in a graph on disk. Each makes looks,
sightings, attributes and relations of four people by the agent's own class, and solves its plan after every turn. The
plans are of the twelve templates' shapes, at times that differ; all are solved in the end.

Service time is what the process of the world model takes for a read or a transaction (timed_process.py), by the clock.
Printed beside: how much of that it is on a processor, which leaves out the disk and what other processes and, on a
rented machine, other tenants take (`stolen`, of this machine's time while the episodes run); and the time that a call
waits, for others and for its turn in this process. A write is a transaction: one statement, of one row or many. What is
commonly written and read is planned before the first use. `other shapes` are the first reads of plans of shapes that no
template has, as a model may make: each takes longer once in a run.

Exit code 1 where the 99th percentile of writes or of the solver's reads is over 10 ms, other shapes left out.
"""

import contextlib
import json
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from older_worlds import older_record

from jrdb_avr.agent.beliefs.solving import beliefs_of
from jrdb_avr.agent.beliefs.world_model import World
from jrdb_avr.queries.beliefs import process as world_process
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.record import merge_world, open_to_replay
from jrdb_avr.schema.method import Observation, Question
from jrdb_avr.schema.panorama import FOV_DEG, Box, crop_left
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_RIGHT

IN_FLIGHT, TURNS, OLDER, BAR_MS = 64, 8, 20_000, 10.0
TALK, RIGHT = "conversation", FIRST_RIGHT
CHAIN = (("a", TALK, "b"), ("b", RIGHT, "c"), ("c", TALK, "d"))
FORK = (("a", TALK, "b"), ("a", RIGHT, "c"), ("b", RIGHT, "d"), ("c", TALK, "d"))
SHAPES = [*[()] * 7, *[CHAIN[:2]] * 3, CHAIN, FORK]
"""Edges of a plan of each template."""
OTHERS = [(*CHAIN[:2], ("a", TALK, "c")), CHAIN[:1] * 2, (*CHAIN, *FORK), (*CHAIN, ("d", TALK, "e")), FORK[:2]]

PEOPLE = ("p1", "p2", "p3", "p4")
TIES = (("p1", TALK, "p2"), ("p3", TALK, "p4"), ("p1", RIGHT, "p3"), ("p2", RIGHT, "p4"))
ACTIONS = ("sitting", "standing", "walking")


def plan_of(number, edges):
    """A plan with these edges, whose times and action go by its number; in every eighth somebody talks with anybody."""
    first, second = 1 + number % TURNS, 1 + (number + 3) % TURNS
    nodes = sorted({"a", *(node for source, _, target in edges for node in (source, target))})
    conditions = {node: [Condition(action=ACTIONS[first % 3], at="t0")] for node in nodes}
    conditions["a"].append(Condition(attribute="gender", value="female"))
    if number % 8 == 0:
        conditions[nodes[-1]].append(Condition(interaction=TALK, at="t0"))
    return Plan(
        "a",
        nodes[-1],
        {"t0": Time(frame=15 * first), "t1": Time(frame=15 * second)},
        tuple(Node(node, tuple(conditions[node])) for node in nodes),
        tuple(Edge(source, relation, target, "t0") for source, relation, target in edges),
        AnswerSpec(mode="multiple_choice", read="action", of=nodes[-1], at="t1"),
    )


class Timed(WorldGraph):
    """A world graph that notes how long callers wait."""

    waited = {"write": [], "read": []}  # noqa: RUF012

    def write(self, *transactions):
        with waiting(self.waited["write"]):
            super().write(*transactions)

    def query(self, *arguments, **options):
        with waiting(self.waited["read"]):
            return super().query(*arguments, **options)


@contextlib.contextmanager
def waiting(times):
    began = time.perf_counter()
    yield
    times.append(time.perf_counter() - began)


def stolen_and_all():
    """Ticks of this machine's processors that other tenants had, and all, since it began; nothing where not told."""
    try:
        ticks = [int(value) for value in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
    except OSError:
        return 0, 0
    return ticks[7], sum(ticks)


def play(world, number, start, played):
    question = Question(f"{number:016x}", "s", "f", "t", f"{number}?", ("sitting", "walking"), "multiple_choice")
    episode, solver = world.episode(question, lambda write: None), beliefs_of(world, question)
    plan = plan_of(number, SHAPES[number % len(SHAPES)])
    episode.plan(plan, 0)
    start.wait()
    with episode.together():
        for step in range(1, TURNS + 1):
            frame, angle = 15 * step, 180.0
            look = Observation("s", frame, f"{frame:06d}", frame / 15, angle, FOV_DEG, int(crop_left(angle)), None)
            seen = {"observation": episode.observed(look, step)}
            for name in PEOPLE:
                entity = {"id": name, "kind": "person", "box": [1, 2, 3, 4], **seen}
                assert episode.add_entity(entity, Box(10, 10, 40, 90), step).accepted
                told = [("action", ACTIONS[step % 3])]
                told += [("gender", "female" if name == "p1" else "male")] if step == 1 else []
                for what, value in told:
                    said = {"entity": name, "name": what, "value": value, **seen}
                    assert episode.add_attribute(said, step).accepted
            for source, name, target in TIES:
                assert episode.add_relation({"source": source, "name": name, "target": target, **seen}, step).accepted
            episode.settle()
            belief = solver.solve(plan, episode.rows())
    if belief.outcome == "defined":
        played.append((episode, solver))


def main():
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.kuzu"
        with open_to_replay(path) as graph:
            merge_world(graph, "older", older_record(OLDER))
        world_process.WORLD_PROCESS = "timed_process"
        with Timed.open(path) as graph:
            world, start, played = World(graph, "r"), threading.Barrier(IN_FLIGHT), []
            threads = [threading.Thread(target=play, args=(world, n, start, played)) for n in range(IN_FLIGHT)]
            before = stolen_and_all()
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            stolen, whole = (now - then for now, then in zip(stolen_and_all(), before, strict=True))
            assert len(played) == IN_FLIGHT, "every plan is solved"
            episode, solver = played[0]
            for edges in OTHERS:
                solver.solve(plan_of(0, edges), episode.rows())
        served, waited = json.loads(Path(f"{path}.times").read_text()), Timed.waited
    others, served["read"] = served["read"][-len(OTHERS) :], served["read"][: -len(OTHERS)]
    print("        calls  seconds  service ms: p50    p99  processor ms: p50    p99  waited ms: p50     p99  p99 / bar")
    worst = 0.0
    for kind in ("write", "read"):
        service, processor = np.array(served[kind]).T
        figures = [p for times in (service, processor, waited[kind]) for p in 1000 * np.percentile(times, (50, 99))]
        worst = max(worst, figures[1] / BAR_MS)
        shown = "{:16.2f} {:6.2f} {:18.2f} {:6.2f} {:15.1f} {:7.1f}".format(*figures)
        print(f"{kind:6} {len(service):6} {service.sum():8.1f} {shown} {figures[1] / BAR_MS:10.2f}")
    service, processor = (" ".join(f"{1000 * time:.1f}" for time in times) for times in zip(*others, strict=True))
    print(f"other shapes: {service} ms, of the processor {processor} ms")
    print(f"stolen: {100 * stolen / max(whole, 1):.1f} %")
    sys.exit(int(worst > 1))


if __name__ == "__main__":
    main()
