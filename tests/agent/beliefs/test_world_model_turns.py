"""Writes of one turn: made together, and what an episode tells without asking the engine."""

import random

import environment
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from world_calls import PLAN, add, begin, belongs, calls_of, look, play, replay, rows_of, say, tables_of

from jrdb_avr.agent.beliefs.display import shown_graph
from jrdb_avr.agent.beliefs.solver import BeliefSolver
from jrdb_avr.agent.beliefs.world_model import MOST_WAITING
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time


@pytest.fixture(scope="module")
def graph():
    with WorldGraph.memory() as made:
        yield made


@settings(max_examples=environment.examples(6), phases=(Phase.explicit, Phase.generate))
@given(st.integers(0, 2**32))
def test_an_episode_believes_what_its_tables_say(graph, seed):
    """Whatever is called, a turn at a time: the rows that an episode tells are those that the solver reads."""
    rng = random.Random(seed)
    episode, writes = begin(graph)
    episode.plan(PLAN, 0)
    calls = calls_of(rng)
    while calls:
        turn, calls = calls[: (most := rng.randrange(1, 20))], calls[most:]
        with episode.together():
            play(episode, turn)
    told, held = episode.rows(), {}
    for name, rows in told.items():
        found = graph.query(read_statement(f"reads/world/{name}.cypher"), {"scope": episode.key}).to_pylist()
        held[name] = [{key: row[key] for key in row if key != "current"} for row in found if row.get("current", True)]
        assert all(row.keys() == held[name][0].keys() for row in rows)
        assert sorted(map(sorted_repr, held[name])) == sorted(map(sorted_repr, rows))
    assert shown_graph(held) == shown_graph(told)
    assert tables_of(graph, belongs(episode.key)) == replay(writes, episode.key)


def sorted_repr(row):
    return repr(sorted(row.items()))


def test_writes_together_are_made_together(graph):
    """What they made is in the tables, and they are in the record, at its end or when they are settled, also where
    something fails; their lines are in the tables at its end.
    """
    episode, writes = begin(graph)
    kept = lambda: [row["number"] for row in rows_of(graph, "Write", belongs(episode.key))]  # noqa: E731
    made = lambda: len(rows_of(graph, "Sighted", belongs(episode.key)))  # noqa: E731
    with pytest.raises(RuntimeError, match="the camera"), episode.together():
        episode.observed(look(15), 1)
        assert add(episode, "p1").accepted and not add(episode, "p1", "o7").accepted
        assert (len(writes), made(), kept()) == (0, 0, [])
        episode.settle()
        assert (len(writes), made(), kept()) == (4, 1, [])
        assert say(episode, "gender", "female").accepted
        raise RuntimeError("the camera")
    assert [(w.number, w.accepted) for w in writes] == [(0, True), (1, True), (2, True), (3, False), (4, True)]
    assert sorted(kept()) == [0, 1, 2, 3, 4]
    assert say(episode, "age", "childhood").accepted and len(writes) == 6


def test_so_many_writes_wait_at_most(graph):
    """An episode of any length makes a bounded number of writes together."""
    episode, writes = begin(graph)
    with episode.together():
        for frame in range(MOST_WAITING - 2):
            episode.observed(look(15 * frame), 1)
        assert not writes, "its beginning waits as well"
        episode.observed(look(15 * MOST_WAITING), 1)
        assert len(writes) == MOST_WAITING


@pytest.mark.parametrize("place", range(MOST_WAITING - 4, MOST_WAITING + 1))
def test_the_write_that_is_too_many_to_wait_may_be_a_new_entity(graph, place):
    """What waits is made when it is complete: the newest entity is known to the sightings made with it."""
    episode, writes = begin(graph)
    with episode.together():
        episode.observed(look(15), 1)
        for n in range(place - 2 - 4):
            episode.noted("get_graph", {"n": n}, 1, True)
        for n in range(6):
            assert add(episode, f"p{n}").accepted
    assert len(writes) == place + 2
    assert tables_of(graph, belongs(episode.key)) == replay(writes, episode.key)


def test_a_plan_runs_again_only_where_what_bears_on_it_has_changed(graph):
    """Its answer is read anew every time, and its people are those of the tables whenever who fits a part changes."""
    episode, _ = begin(graph)
    woman = Node("a", (Condition(attribute="gender", value="female"),))
    answer = AnswerSpec("multiple_choice", "action", "a", at="t0")
    plan = Plan("a", "a", {"t0": Time(frame=15)}, (woman,), (), answer)
    solver = BeliefSolver(graph, episode.key, ("walking", "sitting"))

    def solved():
        before = graph.counts["reads"]
        belief = solver.solve(plan, episode.rows())
        reads = graph.counts["reads"] - before
        assert belief == BeliefSolver(graph, episode.key, solver.choices).solve(plan)
        return belief.outcome, belief.answer, reads

    episode.observed(look(15), 1)
    assert solved() == ("empty", None, 1)
    assert add(episode, "p1").accepted
    assert solved() == ("empty", None, 1), "somebody is seen"
    assert add(episode, "p1").accepted and say(episode, "age", "childhood").accepted
    assert solved() == ("empty", None, 0)
    assert say(episode, "gender", "female").accepted
    assert solved() == ("unknown", None, 1)
    assert say(episode, "action", "sitting").accepted
    assert solved() == ("defined", "sitting", 0)
    assert say(episode, "gender", "male").accepted
    assert solved() == ("empty", None, 0), "as before"


def test_a_plan_that_the_engine_refuses_is_still_a_plan(monkeypatch):
    """`check` passes where the engine refuses the statement: the question is played, and `solve` tells of it."""

    def refuse(*statement, **options):
        raise QueryError("this statement takes too long")

    with WorldGraph.memory() as graph:
        monkeypatch.setattr(graph.graph, "prepare", refuse)
        BeliefSolver(graph, begin(graph)[0].key).check(PLAN)
