"""Processor time of the world model: `python tests/benchmarks/bench_world.py [--smallest]`.

64 episodes are in flight in the graph file of one run, beside 200 episodes that have ended. The episodes take their
turns by rotation in one thread, so that the processor time of each turn can be measured with all threads of the engine.
In a turn an agent makes a look, writes eight people with their attributes and relations, reads the bindings, and reads
the answer. The plans have one, two, three or four people.

`write` is the look and its people, `read` is the answer with its bindings, `turn` is both. Exit code 1 if the median of
turns is over 30 ms or the 99th percentile is over 150 ms.
"""

import random
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import pyarrow as pa

from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.record import merge_world
from jrdb_avr.schema.method import Observation, Question
from jrdb_avr.schema.panorama import FOV_DEG, WIDTH, Box, crop_left
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_RIGHT
from jrdb_avr.schema.tables import RUNS

SMALLEST = "--smallest" in sys.argv
IN_FLIGHT, TURNS, ENDED = (4, 3, 4) if SMALLEST else (64, 6, 200)
MEDIAN_MS, LATE_MS = 30.0, 150.0
TALK = "conversation"
SHAPES = (
    (),
    (("a", TALK, "b"),),
    (("a", TALK, "b"), ("b", FIRST_RIGHT, "c")),
    (("a", TALK, "b"), ("a", FIRST_RIGHT, "c"), ("b", FIRST_RIGHT, "d"), ("c", TALK, "d")),
)
"""Edges of a plan with one, two, three and four people."""
CHOICES = ("sitting", "standing", "walking", "bending")
PEOPLE = 8
FRAMES = tuple(range(0, 300, 15))


def plan_of(number):
    edges = SHAPES[number % len(SHAPES)]
    names = sorted({"a", *(node for source, _, target in edges for node in (source, target))})
    conditions = (Condition(action="walking", at="t0"), Condition(attribute="gender", value="female"))
    return Plan(
        "a",
        names[-1],
        {"t0": Time(frame=60), "t1": Time(frame=120)},
        tuple(Node(name, conditions if name == "a" else (Condition(action="standing", at="t0"),)) for name in names),
        tuple(Edge(source, relation, target, "t0") for source, relation, target in edges),
        AnswerSpec(mode="multiple_choice", read="action", of=names[-1], at="t1"),
    )


def begin(world, number, record=lambda write: None):
    question = Question(f"{number:016x}", "s", f"{number}?", CHOICES, "multiple_choice")
    episode = world.episode(question, record)
    episode.set_plan(plan_of(number), 0)
    return episode


def write_turn(episode, random_, step):
    frame, angle = random_.choice((60, 60, 75, 120)), random_.uniform(0, 359)
    left = int(crop_left(angle))
    look = Observation("s", frame, frame / 15, angle, FOV_DEG, left, None)
    name = episode.observed(look, step)
    people = []
    for number in range(1, PEOPLE + 1):
        labels = (
            ReadLabel("gender", random_.choice(("female", "male"))),
            ReadLabel("action", random_.choice(CHOICES)),
            ReadLabel("action", "talking to someone", random_.random() < 0.3),
        )
        ties = (ReadTie(TALK, number % PEOPLE + 1, random_.random() < 0.4),)
        box = Box((left + 50 * number) % WIDTH, 100.0, 40.0, 120.0)
        people.append(
            (f"p{random_.randrange(2) * PEOPLE + number}", PersonReading(name, number, frame, box, labels, ties))
        )
    episode.add_people(name, people, step)


def read_turn(episode):
    conclusion = episode.conclude(CHOICES, FRAMES)
    bindings = episode.bindings()
    assert conclusion is not None and len(episode.slots(bindings[0])) > 0


def ended_record():
    """The record of episodes that have ended: one episode, under many ids."""
    writes = []
    with WorldGraph.memory() as graph:
        episode, random_ = begin(WorldModel(graph, "ended"), 0, writes.append), random.Random(0)
        for step in range(1, TURNS + 1):
            write_turn(episode, random_, step)
            read_turn(episode)
        episode.answered(None, None, TURNS)
    columns = ("number", "step", "tool", "arguments", "accepted", "reason", "fact")
    rows = []
    for number in range(ENDED):
        key = f"{number:016x}"
        own = {"run_id": "ended", "question_id": key}
        rows += [own | {name: getattr(write, name) for name in columns} for write in writes]
        for row in rows[-len(writes) :]:
            row["fact"] = row["fact"].replace(f"{0:016x}", key)
    return pa.Table.from_pylist(rows, RUNS["world"])


def main():
    times = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder, WorldGraph.open(Path(folder) / "world.kuzu") as graph:
        merge_world(graph.graph, "ended", ended_record())
        world = WorldModel(graph, "r")
        episodes = [(begin(world, number), random.Random(number)) for number in range(IN_FLIGHT)]
        graph.counts.clear()
        for step in range(1, TURNS + 1):
            for episode, random_ in episodes:
                began = time.process_time()
                write_turn(episode, random_, step)
                episode._settle()
                written = time.process_time()
                read_turn(episode)
                ended = time.process_time()
                times["write"].append(1000 * (written - began))
                times["read"].append(1000 * (ended - written))
                times["turn"].append(1000 * (ended - began))
        turns = len(times["turn"])
        counts = {kind: count / turns for kind, count in graph.counts.items()}
    print("       turns  ms of processor: p50      p99")
    for kind, values in times.items():
        median, late = np.percentile(values, (50, 99))
        print(f"{kind:6} {len(values):5} {median:20.2f} {late:8.2f}")
    print("statements per turn:", ", ".join(f"{kind} {count:.1f}" for kind, count in sorted(counts.items())))
    median, late = np.percentile(times["turn"], (50, 99))
    sys.exit(int(not SMALLEST and (median > MEDIAN_MS or late > LATE_MS)))


if __name__ == "__main__":
    main()
