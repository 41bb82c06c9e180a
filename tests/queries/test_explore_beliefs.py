"""The named queries about world models against plain Python over the record, the rows of `world.parquet`."""

import json
import re
from collections import Counter, defaultdict
from pathlib import Path

import pyarrow as pa
import pytest
from belief_runs import ASKED, BELIEF_QUERIES, Believer

from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.engine.run import answering
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.record import merge_world
from jrdb_avr.queries.graph.guard import check_cypher
from jrdb_avr.queries.named import find_query, named_queries
from jrdb_avr.schema.tables import RUNS

STEPS = (0, 1, 2, 4, 7)
END = 10_000_000
KINDS = ("condition", "edge")


@pytest.fixture(scope="module")
def world():
    """A graph with two runs of three questions each, and their records by (run, question)."""
    with WorldGraph.memory() as graph:
        record = {}
        for run_id, turns in (("one", 7), ("two", 4)):
            method = Believer(WorldModel(graph, run_id), turns)
            for question in ASKED[:3]:
                asked = answering.answer_one(method, question, None, None, None)
                assert asked.prediction["status"] == "invalid", asked.prediction
                record[run_id, question.question_id] = asked.world
            mine = [row | {"run_id": run_id} for (run, _), rows in record.items() if run == run_id for row in rows]
            merge_world(graph.graph, run_id, pa.Table.from_pylist(mine, RUNS["world"]))
        yield graph.graph, record


def ask(graph, name, **params):
    text, values = find_query("cypher", name, params)
    check_cypher(text)
    return graph.query(text, values).to_pylist()


def rows_of(record, field, step=END):
    """The rows of a field of all facts up to a step."""
    facts = [json.loads(row["fact"]) for row in record if row["fact"] and row["step"] <= step]
    return [row for fact in facts for row in fact.get(field, ())]


def short(key):
    return key.rpartition("/")[2]


def test_every_query_about_world_models_is_tested_here():
    asked = set(re.findall(r'ask\(graph, "(\w+)"', Path(__file__).read_text())) | {"belief_plan"}
    assert asked == BELIEF_QUERIES <= named_queries("cypher").keys()


def test_runs_of_the_graph(world):
    graph, record = world
    expected = []
    for run_id in ("one", "two"):
        mine = [rows for (run, _), rows in record.items() if run == run_id]
        looks = sum(len(rows_of(rows, "looks")) for rows in mine)
        refused = sum(not row["accepted"] for rows in mine for row in rows)
        counts = {"looks": looks, "writes": sum(map(len, mine)), "refused": refused, "questions": len(mine)}
        expected.append({"run": run_id} | counts)
    assert ask(graph, "world_runs") == expected


def test_writes_of_a_question(world):
    graph, record = world
    for (run, question), rows in record.items():
        names = ("number", "step", "tool", "accepted", "reason", "arguments")
        assert ask(graph, "writes", run=run, question=question) == [{n: row[n] for n in names} for row in rows]


def test_refused_writes(world):
    graph, record = world
    times, questions = Counter(), defaultdict(set)
    for (run, question), rows in record.items():
        for row in rows:
            if run == "one" and not row["accepted"]:
                times[row["tool"], row["reason"]] += 1
                questions[row["tool"], row["reason"]].add(question)
    order = sorted(times.items(), key=lambda item: (-item[1], item[0]))
    assert len(order) > 5
    assert [tuple(row.values()) for row in ask(graph, "refused_writes", run="one")] == [
        (*key, n, len(questions[key])) for key, n in order
    ]


def test_looks_and_boxes(world):
    graph, record = world
    for (run, question), rows in record.items():
        seen, boxes = defaultdict(set), []
        for edge in sorted(rows_of(rows, "sighted"), key=lambda edge: (edge["frame"], edge["write"], edge["number"])):
            seen[edge["target"]].add(short(edge["source"]))
            look = int(short(edge["target"])[1:])
            boxes.append((edge["frame"], short(edge["source"]), edge["step"], look, edge["angle"], *edge["box"]))
        expected = [
            (look["number"], look["step"], look["frame"], round(look["angle"], 1), look["width"], seen[look["id"]])
            for look in rows_of(rows, "looks")
        ]
        found = [tuple(row.values()) for row in ask(graph, "looks", run=run, question=question)]
        assert [(*row[:-1], set(row[-1] or ())) for row in found] == expected
        found = [tuple(row.values()) for row in ask(graph, "seen_when", run=run, question=question)]
        assert [row[:4] for row in found] == [row[:4] for row in boxes]
        assert [row[4:] for row in found] == [pytest.approx(row[4:], abs=0.051) for row in boxes]


@pytest.mark.parametrize("step", STEPS)
def test_what_was_believed_at_a_step(world, step):
    graph, record = world
    for (run, question), rows in record.items():
        sums, since = Counter(), {}
        readings = [(edge["value"], edge) for edge in rows_of(rows, "has", step)]
        readings += [(short(edge["target"]), edge) for edge in rows_of(rows, "related", step)]
        for value, edge in readings:
            if edge["origin"] == "model":
                key = short(edge["source"]), edge["name"], value, edge["frame"]
                sums[key] += edge["weight"]
                since[key] = min(since.get(key, END), edge["step"])
        expected = {(*key, since[key]): weight for key, weight in sums.items() if round(weight, 9) > 0}
        found = ask(graph, "beliefs_at_step", run=run, question=question, step=step)
        assert {tuple(row.values())[:5]: row["weight"] for row in found} == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("step", STEPS)
def test_likeliest_bindings_at_a_step(world, step):
    graph, record = world
    for (run, question), rows in record.items():
        ranked = rows_of(rows, "hypotheses", step)
        last = [row for row in ranked if row["number"] == ranked[-1]["number"]]
        found = ask(graph, "belief_hypotheses", run=run, question=question, step=step)
        names = ("rank", "entity", "nodes", "answer", "verdict", "step")
        assert [[row[n] for n in names] for row in found] == [[row[n] for n in names] for row in last]
        assert [row["log_odds"] for row in found] == pytest.approx([row["log_odds"] for row in last], abs=1e-4)


@pytest.mark.parametrize("step", STEPS)
def test_what_was_unresolved_at_a_step(world, step):
    """The support of parts is tested with the statements of the world model (test_world)."""
    graph, record = world
    resolved = 0
    for (run, question), rows in record.items():
        supports = ask_plan(graph, run, question, step)
        best = [row["nodes"] for row in rows_of(rows, "hypotheses", step) if row["rank"] == 1]
        nodes = dict(pair.split("=") for pair in best[-1].split(", ")) if best else {}
        parts = [slot for slot in rows_of(rows, "slots", step) if slot["kind"] in KINDS]
        expected = []
        for part in parts:
            ends = (nodes.get(part["node"], ""), nodes.get(part["other"], ""))
            mutual = part["name"] == "conversation" and part["kind"] == "edge"
            support = supports.get((part["number"], *(sorted(ends) if mutual else ends)), 0.0)
            if support <= 0:
                expected.append(part["number"])
        resolved += len(parts) - len(expected)
        found = ask(graph, "unresolved_at_step", run=run, question=question, step=step)
        assert [row["part"] for row in found] == expected
    assert step == 0 or resolved > 3


def ask_plan(graph, run, question, step):
    rows = ask(graph, "belief_plan", run=run, question=question, step=step)
    return {(row["part"], row["entity"], row["other_entity"]): row["support"] for row in rows}


def test_what_was_read_of_a_person(world):
    graph, record = world
    names = ("written", "step", "look", "name", "value", "origin")
    for (run, question), rows in record.items():
        for entity in rows_of(rows, "entities"):
            expected = Counter(
                (
                    edge["write"],
                    edge["step"],
                    int(short(edge["target"])[1:]),
                    edge["name"],
                    edge["value"],
                    edge["origin"],
                )
                for edge in rows_of(rows, "has")
                if edge["source"] == entity["id"] and edge["name"] != "entity"
            )
            found = ask(graph, "belief_votes", run=run, question=question, entity=entity["name"])
            assert Counter(tuple(row[n] for n in names) for row in found) == expected
