"""The statements over a world model sum what readings say, and decide the bindings and the answer."""

import itertools
import random

import msgspec
import pytest
from world_calls import (
    CHOICES,
    PLAN,
    begin,
    play,
    question,
    random_people,
    record_of,
    replayed_rows,
    tables_of,
    view,
    whole,
)

from jrdb_avr.agent.look.answer import conclude
from jrdb_avr.agent.look.moments import group_changes
from jrdb_avr.agent.look.ranking import parts_of, rank, slot_supports
from jrdb_avr.agent.perceive.fields import perceivable
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.named import find_query
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP
from jrdb_avr.schema.repeats import USUAL_REPEATS, Repeats

CROWD = 5
"""Seed of four people."""
FRAMES = tuple(range(0, 300, 15))


@pytest.fixture
def graph():
    with WorldGraph.memory() as made:
        yield made


def facts(tracks):
    boxes = {
        (who, one.observation): (one.frame, one.box, one.whole, sorted(one.labels))
        for who, readings in tracks.people.items()
        for one in readings
    }
    return tracks.looks, boxes, {key: sorted(votes) for key, votes in tracks._tie_votes.items()}


def supports(graph, **values):
    """The support of each part of the plan by each person or pair, as users ask for it."""
    text, values = find_query("cypher", "belief_plan", {"run": "r", "question": question(0).question_id, **values})
    rows = graph.graph.query(text, values).to_pylist()
    return {(row["part"], row["entity"], row["other_entity"]): row["support"] for row in rows}


READS = (
    AnswerSpec("multiple_choice", "presence", "b", ("t0", "t1")),
    AnswerSpec("multiple_choice", "distance_change", "b", ("t0", "t1")),
    AnswerSpec("multiple_choice", "attribute", "b", ("t1",), attribute="group_size"),
    AnswerSpec("number", "count", "b", ("t0", "t1"), relation="conversation"),
)


@pytest.mark.parametrize("answer", READS, ids=lambda answer: answer.read)
def test_the_answer_needs_only_the_readings_that_are_asked_for(graph, answer):
    random_ = random.Random(1)
    plan = msgspec.structs.replace(PLAN, answer=answer)
    episode, answers = begin(graph, plan=plan), set()
    for step in range(1, 7):
        play(episode, random_, step)
        expected = conclude(plan, episode.tracks, rank(plan, episode.tracks), ("1", "2", "3", "4"), FRAMES)
        assert episode.conclude(("1", "2", "3", "4"), FRAMES) == expected
        answers.add(expected)
    assert len(answers) > 1


@pytest.mark.parametrize("seed", range(8))
def test_statements_bind_and_answer_as_readings_do_after_every_write(graph, seed):
    random_ = random.Random(seed)
    repeats = (USUAL_REPEATS, Repeats(0.0, 0.5))[seed % 2]
    history, writes = [], []
    episode, plan = begin(graph, writes.append, repeats=repeats), perceivable(PLAN)
    for step in range(1, 8):
        play(episode, random_, step)
        oracle = rank(plan, episode.tracks)
        found = episode.bindings()
        assert [dict(one.nodes) for one in found] == [dict(one.nodes) for one in oracle]
        assert [one.log_odds for one in found] == pytest.approx([one.log_odds for one in oracle], abs=1e-6)
        if found:
            slots = [support.log_odds for _, support in episode.slots(found[0])]
            assert slots == pytest.approx([each.log_odds for _, each in slot_supports(plan, episode.tracks, found[0])])
            assert episode.conclude(CHOICES, FRAMES) == conclude(plan, episode.tracks, oracle, CHOICES, FRAMES)
            assert facts(episode.read_tracks()) == facts(episode.tracks)
        history.append(episode.tracks)
    # What was known at an earlier step can still be asked for.
    for step, tracks in enumerate(history, 1):
        shown = supports(graph, step=step, repeats=repeats.person)
        for number, part in enumerate(parts_of(plan), 1):
            for people in itertools.permutations(tracks.people, len(part.nodes)):
                key = (number, *people, *[""] * (2 - len(people)))
                mutual = part.name == "conversation" and key not in shown
                support = shown.get((number, *sorted(people)) if mutual else key, 0.0)
                assert support == pytest.approx(part.support(tracks, people).log_odds, abs=1e-4)


TWICE = Plan(
    "a", "b", PLAN.times, (Node("a"), Node("b")),
    (Edge("a", FIRST_LEFT, "b", "t0"), Edge("a", FIRST_LEFT, "b", "t1")), PLAN.answer,
)  # fmt: skip


def test_a_relation_of_places_is_asked_at_each_of_its_frames(graph):
    episode = begin(graph, plan=TWICE)
    people = {"p1": (100, 200), "p2": (200, 100)}
    for step, frame in enumerate((60, 120)):
        look = episode.observed(whole(frame), step)
        boxes = [Box(places[step], 100, 50, 150) for places in people.values()]
        readings = [PersonReading(look, number, frame, box) for number, box in enumerate(boxes, 1)]
        episode.add_people(look, [*zip(people, readings, strict=True)], step)
    binding = episode.bindings()[0]
    found = [support.log_odds for _, support in episode.slots(binding)]
    assert found == pytest.approx([support.log_odds for _, support in slot_supports(TWICE, episode.tracks, binding)])
    assert min(found) < 0 < max(found)


def test_a_look_whose_people_are_listed_twice_counts_once(graph):
    episode = begin(graph)
    look = episode.observed(whole(60), 1)
    for number in (1, 2):
        reading = PersonReading(look, number, 60, Box(500 * number, 100, 50, 150))
        episode.add_people(look, [(f"p{number}", reading)], number)
    assert len(episode.tracks.looks[60]) == len(episode.read_tracks().looks[60]) == 1


JOINED = Plan(
    "a", "a", {"t0": Time(frame=60), "j": Time(event="joins_group", of="a", after="t0"), "m": Time(before="j")},
    (Node("a", (Condition(action="walking", at="m"), Condition(attribute="sector", value="left", at="j"))), Node("b")),
    (Edge("a", SAME_GROUP, "b", "j"),),
    AnswerSpec("multiple_choice", "action", "a", ("j",)),
)  # fmt: skip


def test_facts_at_a_group_event_are_asked_at_the_frame_at_which_it_was_read():
    changes = 0
    for seed in range(8):
        random_, writes = random.Random(seed), []
        with WorldGraph.memory() as graph:
            episode, plan = begin(graph, writes.append, JOINED), perceivable(JOINED)
            for step in range(1, 8):
                look = episode.observed(whole(60 + 15 * step), step)
                episode.add_people(look, [*three_people(random_, look, 60 + 15 * step)], step)
                # The people of the event are the likeliest ones by the plan before its change.
                nodes = next((one.nodes for one in rank(plan, episode.tracks)), {})
                before, plan = plan, perceivable(JOINED, group_changes(JOINED, episode.tracks, nodes))
                changes += plan != before
                assert episode.plan == plan
                oracle, found = rank(plan, episode.tracks), episode.bindings()
                assert [dict(one.nodes) for one in found] == [dict(one.nodes) for one in oracle]
                assert [one.log_odds for one in found] == pytest.approx([one.log_odds for one in oracle], abs=1e-6)
    assert changes > 6


@pytest.mark.parametrize("seed", range(3))
def test_the_record_gives_back_the_tables(graph, seed):
    writes, random_ = [], random.Random(seed)
    episode = begin(graph, writes.append)
    for step in range(1, 6):
        play(episode, random_, step)
        episode.bindings()
        episode.refuse("add_people", {"people": "\ud800", "box": [float("nan")]}, "no", step)
    episode.answered(None, episode.conclude(CHOICES, FRAMES), 6)
    rows, replayed = tables_of(graph.graph), replayed_rows(record_of(writes))
    assert all(replayed.values())
    # An agent reads neither its calls nor its bindings, so they are in the record alone.
    assert {name for name in rows if rows[name] != replayed[name]} == {"Hypothesis", "Ranks", "Write", "Wrote"}


def test_an_emptied_graph_concludes_nothing(graph):
    episode = begin(graph)
    look = episode.observed(view(60, 90), 1)
    episode.add_people(look, [*random_people(random.Random(CROWD), look, 60, 90)], 1)
    assert episode.conclude(CHOICES, FRAMES) is not None
    assert episode.bindings()
    graph.graph.execute("MATCH (n) DETACH DELETE n")
    assert episode.conclude(CHOICES, FRAMES) is None
    assert episode.bindings() == ()


def test_calls_that_name_no_look_or_entity_change_nothing(graph):
    episode = begin(graph)
    look = episode.observed(view(60, 90), 1)
    people = [*random_people(random.Random(CROWD), look, 60, 90)]
    episode.add_people(look, people, 1)
    before, rows = episode.tracks, graph.graph.count_rows()
    name = people[0][0]
    for call in (
        lambda: episode.add_people("o9", people, 2),
        lambda: episode.add_people(look, people, 2),
        lambda: episode.add_attribute("p9", look, ReadLabel("gender", "male"), 2),
        lambda: episode.add_relation(name, look, "conversation", "p9", 2),
    ):
        with pytest.raises(DecodeError):
            call()
    assert episode.tracks is before
    assert graph.graph.count_rows() == rows


def test_a_refused_call_keeps_its_arguments(graph):
    writes = []
    episode = begin(graph, writes.append)
    episode.refuse("add_people", msgspec.Raw(b'{"observation":"o9"}'), "not made", 1)
    episode.answered(None, None, 2)
    refused = next(write for write in writes if not write.accepted)
    assert msgspec.json.decode(refused.arguments) == {"observation": "o9"}


def three_people(random_, look, frame):
    for number, name in enumerate(("p1", "p2", "p3"), 1):
        labels = (ReadLabel("action", random_.choice(("walking", "standing"))),)
        ties = (ReadTie(SAME_GROUP, 2, random_.random() < 0.4),) if number != 2 else ()
        yield name, PersonReading(look, number, frame, Box(500 * number, 100, 50, 150), labels, ties)
