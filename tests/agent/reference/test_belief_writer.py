"""What the policy `driven` writes: every reading is an edge, and what all readings come to is current."""

import random
from collections import Counter
from types import SimpleNamespace

import environment
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from world_calls import PLAN, begin, edges_of, look

from jrdb_avr.agent.beliefs.solver import BeliefSolver
from jrdb_avr.agent.look.answer import conclude
from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.look.ranking import rank
from jrdb_avr.agent.perceive.votes import Tracks
from jrdb_avr.agent.reference.belief_writer import BeliefWriter
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import CROP, Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time

SITTING = Plan(
    "a",
    "a",
    {"t0": Time(frame=15)},
    (Node("a", (Condition(action="sitting", at="t0"),)),),
    (),
    AnswerSpec("multiple_choice", "action", "a", ("t0",)),
)


@pytest.fixture(scope="module")
def graph():
    with WorldGraph.memory() as made:
        yield made


class Played:
    """Pictures of frame 15, written as they are read; who is who is known."""

    def __init__(self, graph, plan=SITTING):
        self.graph = graph
        self.episode, self.writes = begin(graph)
        self.episode.plan(plan, 0)
        task = SimpleNamespace(
            question=SimpleNamespace(choices=POSES), sequence=SimpleNamespace(frames=tuple(range(0, 60, 15)))
        )
        self.writer = BeliefWriter(self.episode, BeliefSolver(graph, self.episode.key), plan, plan, task, {})
        self.plan, self.tracks = plan, Tracks({}, {})

    def see(self, *people):
        """A picture of p1, p2, ..., each with the labels and ties that are read and the metres."""
        seen, step = look(15), len(self.writes)
        name = self.episode.observed(seen, step)
        readings = {
            f"p{n}": PersonReading(name, n, 15, Box(1700.0 + 100 * n, 100, 50, 200), labels, ties, metres)
            for n, (labels, ties, metres) in enumerate(people, 1)
        }
        old, looks = self.tracks.people, self.tracks.looks
        shown = {15: (*looks.get(15, ()), SeenColumns(seen.left, CROP))}
        self.tracks = Tracks(
            {who: (*old.get(who, ()), one) for who, one in readings.items()}
            | {who: found for who, found in old.items() if who not in readings},
            shown,
        )
        self.writer.picture(self.tracks, list(readings.values()), seen.left, step)
        return self

    def edges(self, table):
        return edges_of(self.graph, table, self.episode.key)

    def conclude(self):
        hypotheses = rank(self.plan, self.tracks)
        found = conclude(self.plan, self.tracks, hypotheses, POSES, (15,))
        return found, self.writer.concluded(self.tracks, hypotheses, found, 9)


def pose(value, holds=True):
    return ReadLabel("action", value, holds)


def of(*labels, ties=(), metres=None):
    return labels, tuple(ties), metres


def test_a_contradiction_is_a_vote(graph):
    played = Played(graph).see(of(pose("sitting"))).see(of(pose("standing"))).see(of(pose("sitting")))
    rows = played.edges("Has")
    assert [row["value"] for row in rows if row["origin"] == "model"] == ["sitting", "standing", "sitting"]
    (best,) = [row for row in rows if row["current"]]
    assert (best["value"], best["votes"], best["against"]) == ("sitting", 2, 1)
    assert [row["votes"] for row in played.edges("Sighted") if row["current"]] == [3]


def test_what_is_denied_as_often_as_read_is_not_believed(graph):
    played = Played(graph).see(of(pose("reading"))).see(of(pose("reading", holds=False)))
    (row,) = played.edges("Has")
    assert not row["current"]
    played.see(of(pose("reading")))
    assert [(row["votes"], row["against"]) for row in played.edges("Has") if row["current"]] == [(2, 1)]


def test_distances_come_to_their_median(graph):
    played = Played(graph).see(of(metres=2.0)).see(of(metres=3.0))
    assert [(row["number"], row["votes"], row["origin"]) for row in played.edges("Has") if row["current"]] == [
        (2.5, 2, "derived")
    ]


def test_an_answer_is_certain_only_where_the_engine_finds_its_person(graph):
    twice = of(pose("sitting")), of(pose("walking"))
    sure = Played(graph).see(*twice).see(*twice)
    found, verdict = sure.conclude()
    assert (found.entity, found.verdict, verdict) == ("p1", "certain", "certain")
    told = Played(graph).see(*twice).see(*twice)
    # Somebody else of whom the same is believed.
    told.episode.add("add_attribute", {"entity": "p2", "name": "action", "value": "sitting", "observation": "o2"}, 3)
    found, verdict = told.conclude()
    assert (found.entity, found.verdict, verdict) == ("p1", "certain", "supported")
    ranked = told.graph.query(
        "MATCH (e:Episode {id: $id})-[:Ranks]->(h:Hypothesis) RETURN h.rank AS rank, h.entity AS who, e.verdict AS said"
        " ORDER BY rank",
        {"id": told.episode.key},
    )
    assert ranked.to_pylist() == [{"rank": n, "who": f"p{n}", "said": "supported"} for n in (1, 2)]


@pytest.mark.slow
@settings(max_examples=environment.examples(8))
@given(st.integers(0, 2**32))
def test_what_is_current_is_what_the_readings_come_to(graph, seed):
    rng = random.Random(seed)
    played = Played(graph, PLAN)
    for _ in range(rng.randrange(1, 5)):
        labels = [tuple(pose(v, rng.random() < 0.7) for v in rng.sample((*POSES, "reading"), 2)) for _ in "ab"]
        genders = [(ReadLabel("gender", rng.choice(("female", "male")), rng.random() < 0.8),) for _ in "ab"]
        tie = [ReadTie("conversation", 2, rng.random() < 0.5)]
        metres = [rng.choice((None, 2.0, 3.0, 4.5)) for _ in "ab"]
        people = [of(*labels[i], *genders[i], ties=[] if i else tie, metres=metres[i]) for i in (0, 1)]
        with played.episode.together():
            played.see(*people)
    held = {row["name"]: set() for row in played.edges("Has")}
    for row in played.edges("Has"):
        if row["current"]:
            held[row["name"]].add((row["who"], row["value"]))
    tracks = played.tracks
    for who in ("p1", "p2"):
        for name, topic in (("action", "pose"), ("action", "action reading"), ("gender", "gender")):
            tallies = tracks.values(who, topic, 15)
            best = {(who, tallies[0].value)} if tallies and tallies[0].weight > 0 else set()
            values = {"action reading": {"reading"}, "pose": set(POSES)}.get(topic, {"female", "male"})
            assert {one for one in held.get(name, ()) if one[0] == who and one[1] in values} == best
    talks = tracks.relation("p1", "conversation", "p2", 15).log_odds > 0
    assert [row["who"] for row in played.edges("Related") if row["current"]] == ["p1"] * talks
    read = Counter(label.value for one in tracks.people["p1"] for label in one.labels if label.holds)
    written = [row["value"] for row in played.edges("Has") if row["who"] == "p1" and row["name"] != "distance_m"]
    stated = [row for row in played.edges("Has") if row["origin"] == "model" and row["who"] == "p1"]
    assert Counter(row["value"] for row in stated if row["name"] != "distance_m") == read and set(written) >= set(read)
    assert all(write.accepted for write in played.writes)


def test_an_answer_stands_where_its_proof_takes_too_long(graph, monkeypatch):
    def late(*values):
        raise QueryError("stopped after 10 s")

    verdicts = []
    for slow in (False, True):
        with monkeypatch.context() as patch:
            if slow:
                patch.setattr(BeliefSolver, "solve", late)
            sitting = (ReadLabel("action", "sitting"),)
            played = Played(graph)
            for _ in range(3):
                played.see((sitting, (), None))
            verdicts.append(played.conclude()[1])
    assert verdicts == ["certain", "supported"]
