"""The solver over beliefs finds exactly what brute force over the same rows finds, of its own episode only."""

import itertools
import math
import random
from collections import Counter

import pytest
from belief_stories import READS, Story, parsed, planned, random_plan, random_story, write
from environment import examples
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from oracle_beliefs import Mind, plain

from jrdb_avr.agent.beliefs.solver import BeliefSolver
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.graph import table_ddl
from jrdb_avr.schema.rules import Rules

RULES = Rules()
ALL_READS = (*READS, "count")


@pytest.fixture
def graph():
    with Graph.memory(prepares=True) as made:
        for statement in table_ddl(WORLD_NODES, WORLD_RELS):
            made.execute(statement)
        yield made


SEEN = Counter()
RUNS = itertools.count()


OUTCOMES = ("defined", "unknown", "ambiguous", "empty")


def wanted(rng, mind, read, outcome):
    """A random plan with what brute force makes of it; of this outcome where one of some tries has it."""
    for _ in range(100):
        plan = random_plan(rng, mind, read)
        solved = mind.solve(plan)
        if solved[0] == outcome:
            break
    return plan, solved


def compare(graph, seed, outcomes=OUTCOMES):
    """Write random episodes and solve random plans over the first one; the others are there to be mistaken for it."""
    rng = random.Random(seed)
    run = f"run {next(RUNS)}"
    stories = {f"{run}/{n}": random_story(rng) for n in range(rng.randrange(1, 4))}
    write(graph, stories)
    key, story = next(iter(stories.items()))
    mind = Mind(story.rows)
    for read in ALL_READS:
        plan, expected = wanted(rng, mind, read, rng.choice(outcomes))
        belief = BeliefSolver(graph, key, rules=RULES).solve(parsed(plan))
        assert told(belief) == expected, (seed, plan, expected)
        assert bool(belief.missing) == (belief.outcome != "defined"), (seed, plan)
        # The same without the engine, in whatever order the rows come.
        assert BeliefSolver(None, "", rules=RULES).weigh(parsed(plan), rows_of(story, rng)) == belief, (seed, plan)
        if belief.people:
            frame, box = belief.seen
            assert mind.sighted[belief.people[plan["target"]], frame]["box"] == tuple(box)
        if not belief.people or rng.random() < 0.2:
            guess = BeliefSolver(graph, key, rules=RULES).guess(parsed(plan))
            # However far apart the looks are that enclose a moment.
            assert told(guess) == Mind(story.rows, math.inf).guess(plan), (seed, plan)
            frame, box = guess.seen
            who = guess.people[plan["target"]]
            assert mind.sighted[who, frame]["box"] == tuple(box)
            assert guess.outcome == "defined" or (frame, tuple(box)) == mind.newest(who)
            SEEN["guess", guess.outcome] += 1
        SEEN[read, belief.outcome] += 1


def told(belief):
    """A belief as brute force gives it."""
    return belief.outcome, dict(belief.people), dict(belief.times), plain(belief.answer)


def rows_of(story, rng):
    """A story's current rows as the reads of the world namespace give them, shuffled."""
    rows = {
        "sighted": [
            {"who": s["entity"], "frame": s["frame"], "box": dict(zip("xywh", s["box"], strict=True))}
            | {"angle": s["angle"], "written": s["write"], "current": s["current"]}
            for s in story.rows["sightings"]
        ],
        "attributes": [{"who": a["entity"], **a} for a in story.rows["attributes"]],
        "relations": [{**r, "first": r["frame"], "last": r["frame"]} for r in story.rows["relations"]],
        "looks": [{**o, "edge": o["left"]} for o in story.rows["observations"]],
        "entities": [
            {"who": who, "node": story.nodes.get(who, ""), "kind": story.kinds.get(who, "person")}
            for who in {s["entity"] for s in story.rows["sightings"]}
        ],
    }
    rows = {name: [row for row in found if row.get("current", True)] for name, found in rows.items()}
    for found in rows.values():
        rng.shuffle(found)
    return rows


@settings(max_examples=examples(3), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**9))
def test_random_plans_over_random_beliefs_come_to_what_brute_force_finds(graph, seed):
    compare(graph, seed)


@pytest.mark.slow
def test_each_read_was_known_and_unknown(graph):
    for seed in range(examples(4)):
        compare(graph, seed, ("defined",) if seed < 2 else OUTCOMES[1:])
    assert sum(SEEN[read, "defined"] > 0 for read in ALL_READS) >= 8, SEEN
    assert SEEN["guess", "defined"] > 2 and SEEN["guess", "unknown"] > 2, SEEN
    for outcome in ("unknown", "ambiguous", "empty"):
        assert sum(SEEN[read, outcome] for read in ALL_READS) >= 4, SEEN


RELATED = ("next to", "holding", "conversation")


def story_with_things(rng):
    story = Story()
    names = [f"p{n}" for n in range(1, 5)] + ["x1", "x2", "x3"]
    for who in names:
        if who[0] == "x":
            story.is_a(who, rng.choice(("table", "bag", "chair/sofa", "person")))
        for frame in (0, 30):
            if rng.random() < 0.9:
                story.sees(who, frame, action=rng.choice(("sitting", "standing")))
                if rng.random() < 0.4:
                    story.has(who, "color", rng.choice(("red", "blue")), frame)
    there = {(one["entity"], one["frame"]) for one in story.rows["sightings"]}
    for source, target, frame in itertools.product(names, names, (0, 30)):
        if source != target and {(source, frame), (target, frame)} <= there and rng.random() < 0.4:
            story.tie(source, rng.choice(RELATED), target, frame, current=rng.random() < 0.9)
    return story


def plan_with_things(rng):
    kind = rng.choice(("table", "bag", "chair/sofa"))
    nodes = {"a": [{"action": rng.choice(("sitting", "standing")), "at": "t0"}] * rng.randrange(2), "t": []}
    if rng.random() < 0.3:
        nodes["t"] = [{"attribute": "color", "value": rng.choice(("red", "Blue")), "at": "t0"}]
    edges = [("a", rng.choice(("next to", "Next  To", "holding")), "t", "t0")]
    if rng.random() < 0.5:
        # Reached through the thing, maybe at another time.
        nodes["b"] = []
        edges.append(("b", rng.choice(RELATED[:2]), "t", rng.choice(("t0", "t1"))))
        if rng.random() < 0.3:
            edges.append(("a", "conversation", "b", "t0"))
    plan = planned("action", "t0", None, nodes, edges, target=rng.choice([name for name in nodes if name != "t"]))
    plan["nodes"][1]["kind"] = kind
    plan["nodes"][0] |= {"kind": "person"} if rng.random() < 0.2 else {}
    plan["root"] = rng.choice(("a", "t"))
    return plan


@settings(max_examples=examples(4), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**9))
def test_things_are_found_as_by_brute_force(graph, seed):
    compare_things(graph, seed)


def compare_things(graph, seed):
    rng = random.Random(seed)
    key, story = f"things {next(RUNS)}", story_with_things(rng)
    write(graph, {key: story})
    mind = Mind(story.rows, kinds=story.kinds)
    for _ in range(6):
        plan = plan_with_things(rng)
        lower = {**plan, "edges": [{**e, "relation": " ".join(e["relation"].lower().split())} for e in plan["edges"]]}
        expected = mind.solve(lower)
        belief = BeliefSolver(graph, key, rules=RULES).solve(parsed(plan))
        assert told(belief) == expected, (seed, plan, expected)
        assert BeliefSolver(None, "", rules=RULES).weigh(parsed(plan), rows_of(story, rng)) == belief, (seed, plan)
        guess = BeliefSolver(graph, key, rules=RULES).guess(parsed(plan))
        assert mind.kinds.get(guess.people[plan["target"]]) != next(n for n in plan["nodes"] if n["id"] == "t")["kind"]
        SEEN["things", belief.outcome] += 1


@pytest.mark.slow
def test_plans_with_things_had_each_outcome(graph):
    for seed in range(10):
        compare_things(graph, seed)
    assert all(SEEN["things", outcome] for outcome in ("defined", "ambiguous", "empty")), SEEN


def at_moments(rng, plan):
    """Conditions and edges moved from their frames to moments."""
    bounds = ({"after": "t0"}, {"before": "t1"}, {"before": "t0"}, {"after": "t0", "before": "t1"})
    plan["times"] |= {name: rng.choice(bounds) for name in ("u", "v")}
    for part in [*(c for node in plan["nodes"] for c in node["conditions"] if "at" in c), *plan["edges"]]:
        part["at"] = rng.choice((part["at"], "u", "u", "v"))
    return plan


def compare_moments(graph, seed):
    rng = random.Random(seed)
    key, story = f"moments {next(RUNS)}", random_story(rng)
    write(graph, {key: story})
    mind = Mind(story.rows)
    for _ in range(5):
        outcome = rng.choice(OUTCOMES)
        for _ in range(30):
            plan = at_moments(rng, random_plan(rng, mind, "action"))
            expected = mind.solve(plan)
            if expected[0] == outcome:
                break
        belief = BeliefSolver(graph, key, rules=RULES).solve(parsed(plan))
        assert told(belief) == expected, (seed, plan, expected)
        assert bool(belief.missing) == (belief.outcome != "defined"), (seed, plan)
        assert BeliefSolver(None, "", rules=RULES).weigh(parsed(plan), rows_of(story, rng)) == belief, (seed, plan)
        if rng.random() < 0.3:
            guess = BeliefSolver(graph, key, rules=RULES).guess(parsed(plan))
            assert told(guess) == Mind(story.rows, math.inf).guess(plan), (seed, plan)
        SEEN["moments", belief.outcome] += 1


@settings(max_examples=examples(3), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**9))
# A guess where no frame was looked at that the moment may be: somebody's age, which holds at any time, still counts.
@pytest.mark.slow
@example(seed=178825)
def test_what_holds_before_or_after_a_frame_is_found_as_by_brute_force(graph, seed):
    compare_moments(graph, seed)


@pytest.mark.slow
def test_moments_had_each_outcome(graph):
    for seed in range(6):
        compare_moments(graph, seed)
    assert all(SEEN["moments", outcome] for outcome in OUTCOMES), SEEN


def test_an_episode_without_beliefs_is_empty(graph):
    rng = random.Random(1)
    story = random_story(rng)
    write(graph, {"empty/1": Story(), "empty/2": story})
    plan = parsed(random_plan(rng, Mind(story.rows), "action"))
    for key in ("empty/1", "never begun"):
        belief = BeliefSolver(graph, key, rules=RULES).solve(plan)
        assert belief.outcome == "empty" and belief.missing
        assert BeliefSolver(graph, key, rules=RULES).guess(plan) is None
