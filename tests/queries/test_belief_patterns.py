"""Plans as patterns over beliefs: no belief is mistaken for another, however it is worded, whatever a plan's form."""

import itertools
import random

import pytest
from belief_stories import Story, parsed, planned, write
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_beliefs import Mind

from jrdb_avr.agent.beliefs.solver import BeliefSolver
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.compiler.believed import find_believed

WORDS = (
    "x",
    "=",
    "x=",
    "=x",
    "@0",
    "x@0",
    "/",
    "x/",
    "/p1",
    "p1/x=@0/p2",
    "interaction=x",
    "gender=x",
    "gender",
    "//",
    "rx",
)
PEOPLE = ("p1", "p2", "0", "15")
FRAMES = (0, 1, 15)
COUNT = iter(range(10**9))


@pytest.fixture(scope="module")
def world():
    with WorldGraph.memory() as made:
        yield made


def strange_story(rng):
    """People of whom things are said that look like what is said of others."""
    story = Story()
    for who in PEOPLE:
        for frame in FRAMES:
            if rng.random() < 0.97:
                story.sees(who, frame, current=rng.random() < 0.97)
            for name in ("gender", "action", "interaction", "object", "sector", "secto", "x"):
                if rng.random() < 0.6:
                    story.has(who, name, rng.choice(WORDS), frame, current=rng.random() < 0.9)
            for other in PEOPLE:
                for word in rng.sample((*WORDS, "conversation"), 2 * (other != who)):
                    story.tie(who, word, other, frame, current=rng.random() < 0.9)
    return story


def strange_condition(rng):
    word, at = rng.choice(WORDS), rng.choice(("t0", "t0", "t1"))
    kinds = [
        {"attribute": "gender", "value": word},
        {"attribute": "sector", "value": word, "at": at},
        {"action": word, "at": at},
        {"object": word, "verb": rng.choice(WORDS), "at": at},
        {"interaction": rng.choice((word, "conversation")), "at": at},
    ]
    return rng.choice(kinds)


def strange_plan(rng, mind):
    """Mostly conditions and edges that hold of somebody: up to eight of a node, several between two nodes."""
    names = "abcd"[: rng.randrange(1, 5)]
    cast = dict(zip(names, rng.sample(PEOPLE, len(names)), strict=True))
    times = {name: {"frame": frame} for name, frame in zip(("t0", "t1"), rng.sample(FRAMES, 2), strict=True)}
    frame_of = lambda condition: times[condition.get("at", "t0")]["frame"]  # noqa: E731

    def true_of(node):
        tries = (strange_condition(rng) for _ in range(60))
        found = [one for one in tries if mind.holds(cast[node], one, frame_of(one))]
        return (found + [strange_condition(rng)] * (rng.random() < 0.05))[-rng.choice((1, 2, 3, 8)) :]

    nodes = {node: true_of(node) for node in names}
    pairs = [(names[rng.randrange(place)], names[place]) for place in range(1, len(names))]
    pairs += [rng.sample(names, 2) for _ in range(rng.choice((0, 0, 1, 3)) if pairs else 0)]
    edges = []
    for source, target in pairs:
        tried = [(word, time) for word in (*WORDS, "conversation") for time in times]
        true = [one for one in tried if mind.related(cast[source], one[0], cast[target], times[one[1]]["frame"])]
        word, time = rng.choice(true or tried)
        edges.append((source, word, target, time))
    return planned("action", "t0", times, nodes, edges)


@pytest.mark.slow
@settings(max_examples=examples(6))
@given(seed=st.integers(0, 10**9))
def test_strange_words_and_shapes_come_to_what_brute_force_finds(world, seed):
    rng = random.Random(seed)
    key = f"strange/{next(COUNT)}"
    story = strange_story(rng)
    write(world.graph, {key: story})
    mind = Mind(story.rows)
    for _ in range(8):
        plan = strange_plan(rng, mind)
        belief = BeliefSolver(world, key).solve(parsed(plan))
        found = list(mind.bindings(plan))
        targets = {one[plan["target"]] for one in found}
        outcome = "empty" if not found else "ambiguous" if len(targets) > 1 else belief.outcome
        assert belief.outcome == outcome, plan
        assert (belief.people.get(plan["target"]) in targets) == (len(targets) == 1), plan


def test_what_a_plan_asks_for_is_parameters_and_its_form_is_the_statement():
    one = find_believed(parsed(planned(nodes={"a": [{"action": "walking", "at": "t0"}]})))
    other = find_believed(parsed(planned(nodes={"b": [{"object": "x' OR true //", "verb": "holding", "at": "t1"}]})))
    assert one.cypher == other.cypher and one.row.keys() == other.row.keys()
    assert other.row == {
        "n0_s0_frame": 30,
        "n0_c0_name": "object",
        "n0_c0_value": "holding: x' OR true //",
        "n0_c0_frame": 30,
    }
    edges = [("a", "first to the right of (robot view)", "b", "t0"), ("b", "conversation", "a", "t0")]
    joined = find_believed(parsed(planned(nodes={"a": [], "b": []}, edges=edges)))
    assert joined.nodes == ("a", "b")
    # The first edge finds the person, by its direction; what holds both ways is looked for in both.
    assert "(x:Entity {episode_hash: UUID($hash)})-[r:Related]->(n1:Entity" in joined.cypher
    assert "(x:Entity {episode_hash: UUID($hash)})-[r:Related]-(y:Entity" in joined.cypher
    assert [joined.row[f"e{i}_name"] for i in (0, 1)] == [edge[1] for edge in edges]


def test_a_part_that_ties_people_is_a_match_of_its_own():
    """In one MATCH the engine would lose rows of a circle, or take seconds to plan."""
    fork = [("a", "conversation", "b"), ("a", "hugging", "c"), ("b", "conversation", "d"), ("c", "hugging", "d")]
    find = find_believed(parsed(planned(nodes={name: [] for name in "abcd"}, edges=[(*e, "t0") for e in fork])))
    for part in find.cypher.split("MATCH ")[1:]:
        assert part.count("[r:") == 1 and part.count("{episode_hash: UUID($hash)}") == 1 + ("Related]" in part)


def test_a_plan_that_would_keep_the_engine_is_not_run():
    """Everybody talks with everybody: each pair, and each three of them, is a row."""
    people = [f"p{n}" for n in range(64)]
    seen = [{"who": who, "frame": 0, "box": dict.fromkeys("xywh", 1.0), "angle": 1.0, "written": 0} for who in people]
    ties = [{"source": a, "target": b, "name": "conversation"} for a, b in itertools.combinations(people, 2)]
    rows = {"sighted": seen, "attributes": [], "relations": [{**tie, "first": 0, "last": 0} for tie in ties]}
    for names, many in (("abc", True), ("ab", False)):
        edges = [(a, "conversation", b, "t0") for a, b in itertools.pairwise(names)]
        plan = parsed(planned(nodes={name: [] for name in names}, edges=edges))
        belief = BeliefSolver(None, "").weigh(plan, {**rows, "looks": [], "entities": []})
        assert any("too many sets of people" in line for line in belief.missing) == many
        assert belief.outcome == "ambiguous"
