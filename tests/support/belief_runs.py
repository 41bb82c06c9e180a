"""A method that writes a world model at random, seeded by the question, and a run of it."""

import random

from scored_runs import opened, segment_of

from jrdb_avr.engine.run import answering
from jrdb_avr.engine.run import journal as journals
from jrdb_avr.engine.run.methods import open_world
from jrdb_avr.queries.runs import RunManifest, write_run_manifest
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS, HypothesisRow
from jrdb_avr.schema.method import Observation, Panorama, Prediction, Question, SequenceInfo
from jrdb_avr.schema.panorama import FOV_DEG, Box, crop_left
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time

PLAN = Plan(
    "a",
    "b",
    {"t0": Time(frame=0), "t1": Time(frame=150)},
    (Node("a", (Condition(attribute="gender", value="female"),)), Node("b", (Condition(action="sitting", at="t0"),))),
    (Edge("a", "conversation", "b", "t0"),),
    AnswerSpec(mode="multiple_choice", read="action", of="b", at="t1"),
)
BELIEF_QUERIES = {
    *("world_runs", "writes", "refused_writes", "looks", "seen_when"),
    *("beliefs_at_step", "unresolved_at_step", "belief_differences"),
    *("belief_plan", "belief_hypotheses", "belief_votes"),
}
"""The kept queries that ask the world tables."""

WILD = ({}, [], None, "x" * 300, {"observation": "o99"}, {"id": "p1", "kind": "person", "observation": "o1; MATCH (n)"})

MORE = (("action", "walking"), ("action", "talking on the phone"), ("distance_m", 2.5), ("note", "tall"))


def crop(frame, angle):
    return Observation("s", frame, f"{frame:06d}", frame / 15, angle, FOV_DEG, int(crop_left(angle)), None)


class Believer:
    """Makes `turns` calls in each question: looks, sightings, attributes, relations, and calls that are refused."""

    name = "believer"

    def __init__(self, world, turns=40, between=lambda: None):
        self.world, self.turns, self.between = world, turns, between

    def settings(self):
        return {"turns": self.turns}

    def answer(self, task):
        rng = random.Random(task.question.question_id)
        episode = self.world.episode(task.question, task.record_write)
        if rng.random() < 0.8:
            episode.plan(PLAN, 1)
        looks, people = 0, []
        for step in range(2, self.turns):
            self.between()
            kind = rng.random()
            seen = f"o{rng.randint(1, max(1, looks + (rng.random() < 0.1)))}"
            if looks == 0 or kind < 0.1:
                frame = 15 * rng.randrange(3)
                look = Panorama("s", frame, f"{frame:06d}", frame / 15, b"") if rng.random() < 0.2 else None
                episode.observed(look or crop(frame, rng.uniform(0, 359)), step)
                looks += 1
            elif not people or kind < 0.4:
                said = {"id": f"p{rng.randrange(4)}", "kind": rng.choice(["person", "robot"])}
                said |= {"observation": seen, "box": [1, 2, 3, 4]}
                if rng.random() < 0.5:
                    said["node"] = rng.choice("abc")
                x = rng.uniform(0, 400)
                box = Box(x, 10.0, rng.uniform(5, 70), 100.0) if rng.random() < 0.9 else "the box is no box"
                if episode.add("add_entity", said, step, box).accepted:
                    people.append(said["id"])
            elif kind < 0.65:
                name, value = rng.choice(
                    (("gender", "female"), ("gender", "male"), ("age", "young adulthood"), ("action", "sitting"), *MORE)
                )
                said = {"entity": rng.choice(people), "name": name, "value": value, "observation": seen}
                episode.add("add_attribute", said, step)
            elif kind < 0.85:
                names = ["conversation", "in the same group as", "first to the right of (robot view)", "likes"]
                said = {"source": rng.choice(people), "name": rng.choice(names), "observation": seen}
                said["target"] = rng.choice(sorted(set(people) - {said["source"]}) or people)
                episode.add("add_relation", said, step)
            elif kind < 0.95:
                tool = rng.choice(("add_entity", "add_attribute"))
                episode.add(tool, rng.choice(WILD), step, Box(0, 0, 5, 5))
            else:
                episode.noted("get_graph", {}, step, True)
        said = {"answer": 1, "entity": "p1"}
        if rng.random() < 0.5:
            episode.noted("final_answer", said, self.turns, False, "not yet")
        else:
            likely = list(enumerate(dict.fromkeys(people), 1))
            ranked = [
                HypothesisRow(f"{episode.key}/h{n}", episode.key, self.turns, n, who, f"b={who}", -n / 3, "{}", 15)
                for n, who in likely
            ]
            episode.answered(said, self.turns, "supported", ranked)
        return Prediction("invalid")


def world_dump(graph):
    """Every row of every world table of a handle that asks, as sorted tuples."""
    found = {}
    for name, columns in WORLD_NODES.items():
        names = [column.split()[0] for column in columns.split(", ")]
        listed = ", ".join(f"n.{column} AS {column}" for column in names)
        found[name] = graph.query(f"MATCH (n:{name}) RETURN {listed}", ordered=False)
    for name, (source, target, columns) in WORLD_RELS.items():
        names = [column.split()[0] for column in columns]
        listed = "".join(f", r.{column} AS {column}" for column in names)
        pattern = f"MATCH (a:{source})-[r:{name}]->(b:{target}) RETURN a.id AS source, b.id AS target{listed}"
        found[name] = graph.query(pattern, ordered=False)
    return {name: sorted(map(repr, table.to_pylist())) for name, table in found.items()}


ASKED = [Question(f"{n:016x}", "yard-1_0", f"Question {n}?", ("a", "b"), "multiple_choice") for n in range(6)]


INFO = {"yard-1_0": SequenceInfo("yard-1_0", 15.0, 46, (0, 15, 30, 45))}


def run(store, run_id, asked=ASKED, path=None, finish=True, turns=20, **options):
    """A run of the believer, in the store's graph or one of its own."""
    write_run_manifest(
        store, RunManifest(run_id, "believer", "m", "0" * 64, tuple(q.question_id for q in asked), True, {}, "")
    )
    with opened(segment_of(store.run_path(run_id))) as journal:
        record = journals.world_rows(run_id, journal.finished)
        with open_world(path or store.graph_path, run_id, record) as world:
            answering.answer_all(Believer(world, turns, **options), asked, INFO, None, None, journal, 4)
        if finish:
            journals.write_tables(store, run_id, journal.finished)
