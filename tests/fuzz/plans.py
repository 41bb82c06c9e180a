"""Plans of any form: each is refused with the field's name, or runs on the graph of a scene to an outcome."""

from __future__ import annotations

import json
from itertools import pairwise
from random import Random

import limits
from mutate import mutate
from sample_store import sample_store

from jrdb_avr.queries.compiler.find import compile_find
from jrdb_avr.queries.compiler.mapping import SCENE
from jrdb_avr.queries.compiler.reads import SceneReader
from jrdb_avr.queries.compiler.solve import PlanQuery, solve
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.errors import AvrError, PlanError
from jrdb_avr.schema.labels import ACTIONS, INTERACTIONS
from jrdb_avr.schema.plan import canonical, parse_plan
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.things import OBJECTS, VERBS

PER_CASE = 40
READS = {
    "action": ("multiple_choice", 1),
    "attribute": ("multiple_choice", 1),
    "presence": ("multiple_choice", 2),
    "distance_change": ("multiple_choice", 2),
    "next_action": ("multiple_choice", 1),
    "start": ("frame", 1),
    "span": ("span", 2),
    "start_view": ("frame_viewpoint", 1),
    "seconds_between": ("number", 2),
    "count": ("number", 2),
}
_WORDS = [sorted(words) for words in (ACTIONS, INTERACTIONS, RELATIONS, OBJECTS, VERBS)]
_ATTRIBUTES = (
    ("gender", "female"),
    ("age", "young adulthood"),
    ("sector", "left"),
    ("distance", "close"),
    ("group_size", 3),
    ("coat", "red"),
)


def random_plan(rng):
    """A plan, most often a valid one."""
    actions, interactions, relations, objects, verbs = _WORDS
    nodes = [f"n{letter}" for letter in "abcde"[: rng.choice((1, 1, 2, 2, 3, 5))]]
    read = rng.choice(list(READS))
    mode, times = READS[read]
    stated = {f"t{n}": {"frame": 15 * rng.randrange(0, 12) + 60 * n} for n in range(2)}
    events = {}
    for n in range(times):
        kind = rng.choice(
            {
                "next_action": ("end",),
                "span": (("start", "end")[n],),
                "seconds_between": (("start", "leaves"), ("start", "returns"))[n],
            }.get(read, ("start",))
        )
        event = {"event": kind, "of": nodes[0], "after": "t0"}
        if kind in ("start", "end") and read != "next_action":
            event["action"] = rng.choice(actions)
        events[f"e{n}"] = event
    read_at = list(stated) if read in ("action", "attribute", "presence", "distance_change", "count") else list(events)
    at = read_at[:times] if times > 1 else read_at[0]

    def condition():
        match rng.randrange(4):
            case 0:
                name, value = rng.choice(_ATTRIBUTES)
                when = {} if name in ("gender", "age") else {"at": "t0"}
                return {"attribute": name, "value": value, **when}
            case 1:
                return {"action": rng.choice(actions), "at": "t0"}
            case 2:
                return {"object": rng.choice(objects), "verb": rng.choice(verbs), "at": rng.choice(("t0", "t1"))}
        return {"interaction": rng.choice(interactions), "at": "t0"}

    answer = {"mode": mode, "read": read, "of": nodes[0], "at": at}
    if read == "count":
        answer["relation"] = rng.choice(relations + interactions)
    if read == "attribute":
        answer["attribute"] = rng.choice(_ATTRIBUTES)[0]
    return {
        "root": nodes[0],
        "target": nodes[0],
        "times": stated | (events if at not in ("t0", ["t0", "t1"]) else {}),
        "nodes": [{"id": node, "conditions": [condition() for _ in range(rng.choice((0, 1, 1, 2)))]} for node in nodes],
        "edges": [
            {"source": a, "relation": rng.choice(relations + interactions), "target": b, "at": "t0"}
            for a, b in pairwise(nodes)
        ],
        "answer": answer,
    }


prepare = sample_store


def run_case(seed, number, folder, save):
    """Some plans, read, compiled and solved; how many."""
    rng = Random(f"{seed} plans {number}")
    store, sequence = sample_store(folder)
    runs, texts = [], []
    for _ in range(PER_CASE):
        text = json.dumps(random_plan(rng)).encode()
        if rng.random() < 0.6:
            text = mutate(rng, text)[0]
        texts.append(text)
    try:
        for text in texts:
            limits.begin()
            try:
                plan = parse_plan(rng.choice((text, text.decode("utf-8", "surrogateescape"))))
            except PlanError as error:
                assert error.field and "\n" not in str(error), error
                continue
            assert parse_plan(canonical(plan)) == plan
            try:
                compile_find(plan, SCENE)
            except PlanError:
                continue
            runs.append(PlanQuery(plan, sequence))
        with Graph.open(store.graph_path, read_only=True) as graph:
            for query in runs:
                limits.begin()
                try:
                    (solution,) = solve(SceneReader(graph, SCENE, Rules().load), [query], Rules())
                except AvrError as error:
                    assert "\n" not in str(error), error
                else:
                    assert solution.outcome in ("defined", "ambiguous", "empty", "unknown")
                    assert (solution.answer is None) == (solution.outcome != "defined")
    except Exception:
        for n, text in enumerate(texts):
            save(f"plan{n}.json", text)
        raise
    return PER_CASE
