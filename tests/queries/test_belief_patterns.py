"""Plans as patterns over beliefs: no belief is mistaken for another, however it is worded, whatever a plan's form."""

import itertools

from belief_stories import parsed, planned

from jrdb_avr.agent.beliefs.solver import BeliefSolver
from jrdb_avr.queries.compiler.believed import find_believed


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
