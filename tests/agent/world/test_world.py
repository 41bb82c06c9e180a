"""The statements over a world model sum what readings say, and decide the bindings and the answer."""

import contextlib
import itertools
import random

import numpy as np
import pytest

from jrdb_avr.agent.look.answer import conclude
from jrdb_avr.agent.look.moments import group_changes
from jrdb_avr.agent.look.ranking import parts_of, rank, slot_supports
from jrdb_avr.agent.perceive.fields import perceivable
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.named import find_query
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Question
from jrdb_avr.schema.panorama import CROP, FOV_DEG, WIDTH, Box, crop_left
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time, validate
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP
from jrdb_avr.schema.repeats import USUAL_REPEATS, Repeats

CHOICES = ("walking", "standing", "talking to someone", "sitting")
CROWD = 5
"""Seed of four people."""
FRAMES = tuple(range(0, 300, 15))
PLAN = Plan(
    "a", "b", {"t0": Time(frame=60), "t1": Time(frame=120)},
    (Node("a", (Condition(attribute="gender", value="female"), Condition(action="walking", at="t0"),
                Condition(attribute="sector", value="left", at="t0"), Condition(interaction="conversation", at="t0"))),
     Node("b"), Node("c", (Condition(attribute="group_size", value=2, at="t0"),))),
    (Edge("a", FIRST_LEFT, "b", "t0"), Edge("a", "conversation", "c", "t0"), Edge("b", SAME_GROUP, "c", "t0")),
    AnswerSpec("multiple_choice", "action", "b", ("t1",)),
)  # fmt: skip


@pytest.fixture
def graph():
    with WorldGraph.memory() as made:
        yield made


def view(frame, angle):
    image = np.zeros((CROP, CROP, 3), np.uint8)
    return Observation("s", frame, f"{frame:06d}", frame / 15, float(angle), FOV_DEG, crop_left(angle), image)


def begin(graph, record=lambda write: None, plan=PLAN, repeats=USUAL_REPEATS):
    validate(plan)
    question = Question("q", "s", "Who?", CHOICES, "multiple_choice")
    episode = WorldModel(graph, "r", repeats).episode(question, record)
    episode.set_plan(plan, 0)
    return episode


def random_people(random_, look, frame, angle):
    names = random_.sample(("p1", "p2", "p3", "p4", "p5"), random_.randint(0, 4))
    left = crop_left(angle)
    for number, name in enumerate(names, 1):
        labels = [ReadLabel("gender", random_.choice(("female", "male")))] if random_.random() < 0.7 else []
        for _ in range(random_.choice((1, 1, 2))):
            labels += [ReadLabel("action", random_.choice(("walking", "standing", "sitting")), random_.random() < 0.8)]
        labels += [ReadLabel("action", "talking to someone", random_.random() < 0.5)]
        labels += [ReadLabel("interaction", "conversation", random_.random() < 0.5)] if random_.random() < 0.4 else []
        ties = [
            ReadTie(relation, other, random_.random() < 0.5)
            for relation in ("conversation", SAME_GROUP)
            for other in range(1, len(names) + 1)
            if other != number and random_.random() < 0.7
        ]
        box = Box((left + random_.randint(1, 400)) % WIDTH, 100.0, 50.0, random_.randint(60, 200))
        yield name, PersonReading(look, number, frame, box, tuple(labels), tuple(ties), whole=random_.random() < 0.8)


def facts(tracks):
    boxes = {
        (who, one.observation): (one.frame, one.box, one.whole, sorted(one.labels))
        for who, readings in tracks.people.items()
        for one in readings
    }
    return tracks.looks, boxes, {key: sorted(votes) for key, votes in tracks._tie_votes.items()}


def play(episode, random_, step):
    """Make one or two looks, write their people in any order, and add attributes and relations to any look."""
    frame, angle = random_.choice((60, 60, 75, 120)), random_.randrange(0, 360, 20)
    looks = [episode.observed(view(frame, angle + turn), step) for turn in random_.choice(((0,), (0, 10)))]
    turns = dict(zip(looks, (0, 10), strict=False))
    for look in random_.sample(looks, len(looks)):
        episode.add_people(look, [*random_people(random_, look, frame, angle + turns[look])], step)
    for _ in range(random_.randint(0, 4)):
        look = f"o{random_.randint(1, int(looks[-1][1:]))}"
        first, second = random_.sample(("p1", "p2", "p3", "p4", "p5"), 2)
        label = random_.choice((ReadLabel("gender", "female"), ReadLabel("action", "sitting", random_.random() < 0.5)))
        with contextlib.suppress(DecodeError):
            if random_.random() < 0.5:
                episode.add_attribute(first, look, label, step)
            else:
                episode.add_relation(first, look, random_.choice(("conversation", SAME_GROUP)), second, step)


def supports(graph, **values):
    """The support of each part of the plan by each person or pair, as users ask for it."""
    text, values = find_query("cypher", "belief_plan", {"run": "r", "question": "q", **values})
    rows = graph.graph.query(text, values).to_pylist()
    return {(row["part"], row["entity"], row["other_entity"]): row["support"] for row in rows}


@pytest.mark.parametrize("seed", range(8))
def test_statements_bind_and_answer_as_readings_do_after_every_write(graph, seed):
    random_ = random.Random(seed)
    repeats = (USUAL_REPEATS, Repeats(0.0, 0.5))[seed % 2]
    episode = begin(graph, repeats=repeats)
    plan = perceivable(PLAN)
    history = []
    for step in range(1, 8):
        play(episode, random_, step)
        oracle = rank(plan, episode.tracks)
        found = episode.bindings()
        assert [dict(one.nodes) for one in found] == [dict(one.nodes) for one in oracle]
        assert [one.log_odds for one in found] == pytest.approx([one.log_odds for one in oracle], abs=1e-6)
        if found:
            slots = [slot.support.log_odds for slot in episode.slots(found[0])]
            assert slots == pytest.approx([s.support.log_odds for s in slot_supports(plan, episode.tracks, found[0])])
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
                look = episode.observed(panorama(60 + 15 * step), step)
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


def panorama(frame):
    return Panorama("s", frame, f"{frame:06d}", frame / 15, b"")


def three_people(random_, look, frame):
    for number, name in enumerate(("p1", "p2", "p3"), 1):
        labels = (ReadLabel("action", random_.choice(("walking", "standing"))),)
        ties = (ReadTie(SAME_GROUP, 2, random_.random() < 0.4),) if number != 2 else ()
        yield name, PersonReading(look, number, frame, Box(500 * number, 100, 50, 150), labels, ties)


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
