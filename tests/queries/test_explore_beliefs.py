"""The kept queries over beliefs against plain Python over the record, the rows of `world.parquet`."""

import json
import re
from collections import Counter, defaultdict
from pathlib import Path

import pytest
from belief_runs import ASKED, BELIEF_QUERIES, Believer
from world_calls import PLAN, begin, join, seen_twice

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.engine.run import answering
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.graph.guard import check_cypher
from jrdb_avr.queries.named import find_query, named_queries

STEPS = (0, 3, 9, 15, 24, 40)
ALWAYS = 10_000_000


@pytest.fixture(scope="module")
def world():
    """A graph with two runs of six questions each, and their records by (run, question)."""
    with WorldGraph.memory() as graph:
        record = {}
        for run_id, turns in (("one", 40), ("two", 25)):
            method = Believer(WorldModel(graph, run_id), turns)
            for question in ASKED[:6]:
                asked = answering.answer_one(method, question, None, None, None)
                assert asked.prediction["status"] == "invalid", asked.prediction
                record[run_id, question.question_id] = asked.world
        yield graph, record


def ask(graph, name, **params):
    text, values = find_query("cypher", name, params)
    check_cypher(text)
    return [tuple(row.values()) for row in graph.query(text, values).to_pylist()]


def facts(rows):
    return [(row, json.loads(row["fact"])) for row in rows if row["fact"]]


def entities(rows):
    """Of the end: name -> entity."""
    held = {}
    for _, fact in facts(rows):
        for key in fact.get("freed", ()):
            held[key.rpartition("/")[2]]["node"] = ""
        for entity in (fact.get("entity"), fact.get("changed")):
            if entity:
                held[entity["name"]] = dict(entity)
    return held


def edges(rows, kind):
    """(edge, the step at which it was replaced or None)"""
    made = {row["number"]: [fact[kind], None] for row, fact in facts(rows) if kind in fact}
    for row, fact in facts(rows):
        for number in fact.get("replaced", ()):
            if number in made:
                made[number][1] = row["step"]
    return [tuple(edge) for edge in made.values()]


def at(rows, kind, step):
    return [e for e, until in edges(rows, kind) if e["step"] <= step and (until is None or until > step)]


def sighting_order(made):
    return made[0]["frame"], made[0]["write"], made[0]["source"]


def short(key):
    return key.rpartition("/")[2]


def test_every_query_over_beliefs_is_here():
    asked = set(re.findall(r'ask\(graph, "(\w+)"', Path(__file__).read_text()))
    assert asked == BELIEF_QUERIES <= named_queries("cypher").keys()


def test_runs_of_the_graph(world):
    graph, record = world
    expected = []
    for run_id in ("one", "two"):
        mine = [rows for (run, _), rows in record.items() if run == run_id]
        looks = sum("observation" in fact for rows in mine for _, fact in facts(rows))
        refused = sum(not row["accepted"] for rows in mine for row in rows)
        expected.append((run_id, looks, sum(map(len, mine)), refused, len(mine)))
    assert ask(graph, "world_runs") == expected


def test_writes_of_a_question(world):
    graph, record = world
    for (run, question), rows in record.items():
        names = ("number", "step", "tool", "accepted", "reason", "arguments")
        assert ask(graph, "writes", run=run, question=question) == [tuple(r[n] for n in names) for r in rows]


def test_refused_writes(world):
    graph, record = world
    times, where = Counter(), defaultdict(set)
    for (run, question), rows in record.items():
        for row in rows:
            if run == "one" and not row["accepted"]:
                times[row["tool"], row["reason"]] += 1
                where[row["tool"], row["reason"]].add(question)
    expected = [(*key, n, len(where[key])) for key, n in sorted(times.items(), key=lambda item: (-item[1], item[0]))]
    assert len(expected) > 5
    assert ask(graph, "refused_writes", run="one") == expected


def test_looks_and_who_is_in_them(world):
    graph, record = world
    for (run, question), rows in record.items():
        seen = defaultdict(set)
        for edge, _ in edges(rows, "sighted"):
            seen[edge["target"]].add(short(edge["source"]))
        expected = [
            (o["number"], o["step"], o["frame"], round(o["angle"], 1), o["width"], sorted(seen[o["id"]]))
            for o in (fact["observation"] for _, fact in facts(rows) if "observation" in fact)
        ]
        found = ask(graph, "looks", run=run, question=question)
        assert [(*row[:-1], row[-1] or []) for row in found] == expected


def test_what_was_seen_when(world):
    graph, record = world
    for (run, question), rows in record.items():
        held = entities(rows)
        expected = []
        for e, until in sorted(edges(rows, "sighted"), key=sighting_order):
            of = held[short(e["source"])]
            said = (e["frame"], of["name"], of["kind"], of["node"], e["step"], int(short(e["target"])[1:]), e["angle"])
            expected.append((*said, *e["box"], until is None))
        found = ask(graph, "seen_when", run=run, question=question)
        assert len(found) == len(expected)
        for row, wanted in zip(found, expected, strict=True):
            assert row[:6] + row[11:] == wanted[:6] + wanted[11:]
            assert row[6:11] == pytest.approx(wanted[6:11], abs=0.051)


@pytest.mark.parametrize("step", STEPS)
def test_beliefs_at_a_step(world, step):
    graph, record = world
    for (run, question), rows in record.items():
        has = [
            (short(e["source"]), e["name"], None if e["last"] == ALWAYS else e["first"], e["value"], e["step"])
            for e in at(rows, "has", step)
        ]
        related = [
            (short(e["source"]), e["name"], e["first"], short(e["target"]), e["step"])
            for e in at(rows, "related", step)
        ]
        found = ask(graph, "beliefs_at_step", run=run, question=question, step=step)
        assert Counter((entity, name, frame, value, since) for entity, name, value, frame, since in found) == Counter(
            has + related
        )


def resolved(slot, rows, step):
    """Whether an episode had found what a slot of its plan asks for."""
    nodes = {name: entity["node"] for name, entity in entities(rows).items()}

    def holds(edge):
        return slot["frame"] < 0 or edge["first"] <= slot["frame"] <= edge["last"]

    match slot["kind"]:
        case "node":
            return any(e["node"] == slot["node"] and e["step"] <= step for e in entities(rows).values())
        case "condition":
            wanted = (slot["node"], slot["name"], slot["value"])
            found = at(rows, "has", step)
            return any((nodes[short(e["source"])], e["name"], e["value"]) == wanted and holds(e) for e in found)
        case "edge":
            # The plan's one edge is a conversation, which holds both ways.
            wanted = {slot["node"], slot["other"]}
            found = [e for e in at(rows, "related", step) if e["name"] == slot["name"]]
            return any({nodes[short(e["source"])], nodes[short(e["target"])]} == wanted and holds(e) for e in found)


@pytest.mark.parametrize("step", STEPS)
def test_what_was_unresolved_at_a_step(world, step):
    graph, record = world
    found = 0
    for (run, question), rows in record.items():
        slots = [slot for _, fact in facts(rows) for slot in fact.get("slots", ()) if slot["kind"] != "read"]
        expected = [slot["number"] for slot in slots if not resolved(slot, rows, step)]
        found += len(slots) - len(expected)
        assert [row[0] for row in ask(graph, "unresolved_at_step", run=run, question=question, step=step)] == expected
    assert step < 20 or found > 3


def test_which_beliefs_bear_on_the_plan(world):
    graph, record = world
    found = Counter()
    for (run, question), rows in record.items():
        expected = []
        for slot in (slot for _, fact in facts(rows) for slot in fact.get("slots", ())):
            kind = {"condition": "has", "edge": "related"}.get(slot["kind"])
            for e, until in edges(rows, kind) if kind else ():
                alike = e["name"] == slot["name"] and (kind == "related" or e["value"] == slot["value"])
                there = slot["frame"] < 0 or e["first"] <= slot["frame"] <= e["last"]
                if until is None and alike and there:
                    ends = (short(e["source"]), short(e["target"]) if kind == "related" else "")
                    frame = None if e["last"] == ALWAYS else e["first"]
                    part = tuple(slot[name] for name in ("number", "node", "other", "name", "value"))
                    expected.append((*part, *ends, frame, e["votes"], e["against"], e["origin"]))
                    found[kind] += 1
        assert Counter(ask(graph, "belief_plan", run=run, question=question)) == Counter(expected)
    assert found["has"] > 2


def test_a_relation_bears_on_the_plan():
    with WorldGraph.memory() as graph:
        episode, _ = begin(graph, 5)
        episode.plan(PLAN, 0)
        seen_twice(episode, 15, 30)
        assert join(episode, "conversation", "p2", "p1").accepted and join(episode, "hugging").accepted
        assert join(episode, "conversation", "p1", "p2", "o2").accepted
        (row,) = ask(graph, "belief_plan", run="run", question=f"{5:016x}")
        assert row[1:] == ("a", "b", "conversation", "", "p2", "p1", 15, 1, 0, "model")


def test_who_the_plans_people_may_be(world):
    graph, record = world
    some = 0
    for (run, question), rows in record.items():
        verdict = next((fact["episode"]["verdict"] for _, fact in reversed(facts(rows)) if "episode" in fact), "")
        held = [(e, until) for e, until in edges(rows, "sighted") if until is None]
        expected = []
        for h in (h for _, fact in facts(rows) for h in fact.get("hypotheses", ())):
            for e, _ in held:
                if (short(e["source"]), e["frame"]) == (h["entity"], h["frame"]):
                    said = (h["rank"], h["entity"], h["nodes"], round(h["log_odds"], 2), h["answer"])
                    box = tuple(round(side, 1) for side in e["box"])
                    expected.append((*said, verdict if h["rank"] == 1 else "", h["step"], 15, *box, e["votes"]))
        some += len(expected)
        listed = ask(graph, "belief_hypotheses", run=run, question=question)
        assert [row[:8] for row in listed] == [row[:8] for row in expected]
        for row, wanted in zip(listed, expected, strict=True):
            assert row[8:] == pytest.approx(wanted[8:], abs=0.051)
    assert some > 5


def test_what_was_read_of_somebody(world):
    graph, record = world
    for (run, question), rows in record.items():
        for who in entities(rows):
            expected = [
                (
                    *(None if e["last"] == ALWAYS else e["first"], e["write"], int(short(e["target"])[1:])),
                    *(e[name] for name in ("votes", "against", "name", "value", "origin")),
                    until is None,
                )
                for e, until in edges(rows, "has")
                if short(e["source"]) == who
            ]
            assert Counter(ask(graph, "belief_votes", run=run, question=question, entity=who)) == Counter(expected)


def test_where_two_runs_differ(world):
    graph, record = world
    some = 0
    for question in {question for _, question in record}:
        said = {}
        for run in ("one", "two"):
            rows = record[run, question]
            nodes = {name: entity["node"] for name, entity in entities(rows).items()}
            said[run] = {
                (nodes[short(e["source"])], e["name"], None if e["last"] == ALWAYS else e["first"], e["value"])
                for e, until in edges(rows, "has")
                if until is None and nodes[short(e["source"])]
            }
        expected = {(*f, "one") for f in said["one"] - said["two"]} | {(*f, "two") for f in said["two"] - said["one"]}
        found = ask(graph, "belief_differences", run="one", other="two", question=question)
        assert len(found) == len(set(found))
        assert set(found) == expected
        some += len(found)
    assert some > 5
