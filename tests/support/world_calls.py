"""World models of agents: a plan, random writes, and rows of the tables."""

import contextlib
import random

import numpy as np
import pyarrow as pa

from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.record import replay
from jrdb_avr.queries.graph.handle import build_graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.graph import scene_ddl
from jrdb_avr.schema.method import Observation, Panorama, Question
from jrdb_avr.schema.panorama import CROP, FOV_DEG, WIDTH, Box, crop_left
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time, validate
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP
from jrdb_avr.schema.repeats import USUAL_REPEATS
from jrdb_avr.schema.tables import RUNS

CHOICES = ("walking", "standing", "talking to someone", "sitting")
PLAN = Plan(
    "a", "b", {"t0": Time(frame=60), "t1": Time(frame=120)},
    (Node("a", (Condition(attribute="gender", value="female"), Condition(action="walking", at="t0"),
                Condition(attribute="sector", value="left", at="t0"), Condition(interaction="conversation", at="t0"))),
     Node("b"), Node("c", (Condition(attribute="group_size", value=2, at="t0"),))),
    (Edge("a", FIRST_LEFT, "b", "t0"), Edge("a", "conversation", "c", "t0"), Edge("b", SAME_GROUP, "c", "t0")),
    AnswerSpec("multiple_choice", "action", "b", ("t1",)),
)  # fmt: skip

SCENE = (
    "CREATE (:Person {id: 'secret/1', sequence: 'secret', track: 1, gender: 'female'})",
    "CREATE (:Person {id: 'secret/2', sequence: 'secret', track: 2})",
    "CREATE (:Frame {id: 'secret/000000', sequence: 'secret', frame: 0})",
    "MATCH (p:Person {id: 'secret/1'}), (f:Frame {id: 'secret/000000'}) "
    "CREATE (p)-[:SeenIn {sequence: 'secret', frame: 0, box: {x: 1.0, y: 2.0, w: 3.0, h: 4.0}}]->(f)",
    "MATCH (p:Person {id: 'secret/1'}), (q:Person {id: 'secret/2'}) "
    "CREATE (p)-[:Interacts {sequence: 'secret', label: 'conversation'}]->(q)",
)
"""A scene of two people."""


def view(frame, angle):
    image = np.zeros((CROP, CROP, 3), np.uint8)
    return Observation("s", frame, frame / 15, float(angle), FOV_DEG, crop_left(angle), image)


def whole(frame):
    return Panorama("s", frame, frame / 15, b"")


def question(number):
    return Question(f"{number:016x}", "s", "Who?", CHOICES, "multiple_choice")


def begin(graph, record=lambda write: None, plan=PLAN, repeats=USUAL_REPEATS, number=0, run="r"):
    validate(plan)
    episode = WorldModel(graph, run, repeats).episode(question(number), record)
    episode.set_plan(plan, 0)
    return episode


def random_people(random_, look, frame, angle):
    names = random_.sample(("p1", "p2", "p3", "p4", "p5"), random_.randint(0, 4))
    left = crop_left(angle)
    for number, name in enumerate(names, 1):
        labels = [ReadLabel("gender", random_.choice(("female", "male")))] if random_.random() < 0.7 else []
        for _ in range(random_.choice((1, 1, 2))):
            labels += [ReadLabel("action", random_.choice(("walking", "standing", "sitting")), random_.random() < 0.8)]
        labels += [ReadLabel("action", "talking to someone", random_.random() < 0.5)]
        labels += [ReadLabel("interaction", "conversation", random_.random() < 0.5)] if random_.random() < 0.4 else []
        ties = [
            ReadTie(relation, other, random_.random() < 0.5)
            for relation in ("conversation", SAME_GROUP)
            for other in range(1, len(names) + 1)
            if other != number and random_.random() < 0.7
        ]
        box = Box((left + random_.randint(1, 400)) % WIDTH, 100.0, 50.0, random_.randint(60, 200))
        yield name, PersonReading(look, number, frame, box, tuple(labels), tuple(ties), whole=random_.random() < 0.8)


def play(episode, random_, step):
    """Make one or two looks, write their people in any order, and add attributes and relations to any look."""
    frame, angle = random_.choice((60, 60, 75, 120)), random_.randrange(0, 360, 20)
    looks = [episode.observed(view(frame, angle + turn), step) for turn in random_.choice(((0,), (0, 10)))]
    turns = dict(zip(looks, (0, 10), strict=False))
    for look in random_.sample(looks, len(looks)):
        episode.add_people(look, [*random_people(random_, look, frame, angle + turns[look])], step)
    for _ in range(random_.randint(0, 4)):
        look = f"o{random_.randint(1, int(looks[-1][1:]))}"
        first, second = random_.sample(("p1", "p2", "p3", "p4", "p5"), 2)
        label = random_.choice((ReadLabel("gender", "female"), ReadLabel("action", "sitting", random_.random() < 0.5)))
        with contextlib.suppress(DecodeError):
            if random_.random() < 0.5:
                episode.add_attribute(first, look, label, step)
            else:
                episode.add_relation(first, look, random_.choice(("conversation", SAME_GROUP)), second, step)


def believe(world, number=0, turns=4):
    """An episode with a few turns, and its end."""
    episode = begin(world, number=number)
    for step in range(1, turns):
        play(episode, random.Random(100 * number + step), step)
    episode.answered(None, episode.conclude(CHOICES, tuple(range(0, 300, 15))), turns)
    return episode


def scene_in(folder):
    """Write a graph with a scene in which two people are to be kept from agents, and without world tables."""
    path = folder / "graph.kuzu"
    with build_graph(path) as graph:
        for statement in (*scene_ddl(), *SCENE):
            graph.execute(statement)
    return path


@contextlib.contextmanager
def beside_scene(folder):
    """World tables in a graph with a scene."""
    with WorldGraph.open(scene_in(folder)) as world:
        yield world


def tables_of(graph):
    """All rows of the world tables of a session on a graph, sorted; edges with the keys of their ends."""
    tables = {}
    for name, columns in WORLD_NODES.items():
        listed = ", ".join(f"n.{column.split()[0]} AS {column.split()[0]}" for column in columns.split(", "))
        tables[name] = graph.query(f"MATCH (n:{name}) RETURN {listed}", ordered=False)
    for name, (source, target, columns) in WORLD_RELS.items():
        listed = "".join(f", r.{column.split()[0]} AS {column.split()[0]}" for column in columns)
        pattern = f"MATCH (a:{source})-[r:{name}]->(b:{target}) RETURN a.id AS `from`, b.id AS `to`{listed}"
        tables[name] = graph.query(pattern, ordered=False)
    return {name: sorted(table.to_pylist(), key=repr) for name, table in tables.items()}


def record_of(writes, run="r", number=0):
    """The record of an episode's writes."""
    columns = ("number", "step", "tool", "arguments", "accepted", "reason", "fact")
    own = {"run_id": run, "question_id": question(number).question_id}
    return pa.Table.from_pylist(
        [own | {name: getattr(write, name) for name in columns} for write in writes], RUNS["world"]
    )


def replayed_rows(record):
    """All rows of the world tables as a record alone gives them, sorted."""
    return {name: sorted(table.to_pylist(), key=repr) for name, table in replay(record).items()}
