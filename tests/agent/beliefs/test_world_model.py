"""The agent's world model: what is refused and why, what replaces what, and episodes side by side."""

import json
import math
import threading

import pytest
from belief_stories import hash_of
from world_calls import (
    PLAN,
    VICTIM,
    add,
    begin,
    believe,
    belongs,
    beside_scene,
    edges_of,
    join,
    look,
    replay,
    rows_of,
    say,
    seen_twice,
    tables_of,
    whole,
)

from jrdb_avr.agent.beliefs.display import shown_graph
from jrdb_avr.agent.beliefs.world_model import MOST_ENTITIES, MOST_WRITES
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import validate
from jrdb_avr.schema.relations import FIRST_LEFT


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """World tables beside a scene, and in them an episode that nobody else may touch."""
    with beside_scene(tmp_path_factory.mktemp("world")) as world:
        believe(world, 999)
        yield world


@pytest.fixture
def episode(graph):
    return begin(graph)[0]


# -- the rules, one by one --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda e: add(e, observation="o9"), "'o9' has not been made; made: o1, o2"),
        (lambda e: add(e, observation=f"{VICTIM}/o1"), "has not been made"),
        (lambda e: add(e, "p 1"), "id must be a name of 1 to 32 letters"),
        (lambda e: add(e, "p" * 33), "id must be a name of 1 to 32 letters"),
        (lambda e: add(e, node="c"), "node 'c' is none of the plan's: a, b"),
        (lambda e: add(e, box="box has no area"), "box has no area"),
        (lambda e: add(e, box=Box(math.nan, 0, 10, 10)), "must lie in the observation's image"),
        (lambda e: add(e, box=Box(0, 0, math.inf, 10)), "must lie in the observation's image"),
        (lambda e: add(e, box=Box(470, 0, 20, 10)), "must lie in the observation's image"),
        (lambda e: add(e, box=Box(0, 0, 0, 10)), "must lie in the observation's image"),
        (lambda e: add(e, colour="red"), "keys that the contract does not know: colour"),
        (lambda e: say(e, "gender", "female", "p3"), "there is no entity 'p3'"),
        (lambda e: say(e, "action", "walking", observation="o2"), "p1 has no sighting at frame 000030"),
        (lambda e: say(e, "gender", "impossible"), "gender has no value 'impossible'; it is male, female"),
        (lambda e: say(e, "action", "flying"), "action has no value 'flying'"),
        (lambda e: say(e, "object", "holding a bag"), 'object must be "verb: thing"'),
        (lambda e: say(e, "group_size", "3"), "group_size must be a whole number from 1 to 1000"),
        (lambda e: say(e, "group_size", 2.5), "group_size must be a whole number from 1 to 1000"),
        (lambda e: say(e, "group_size", True), "group_size must be a whole number from 1 to 1000"),
        (lambda e: say(e, "distance_m", 10**400), "distance_m must be a number from 0 to 1000"),
        (lambda e: say(e, "distance_m", math.nan), "distance_m must be a number from 0 to 1000"),
        (lambda e: say(e, "coat", "\ud800"), "value must be a text of 1 to 120 printable characters"),
        (lambda e: say(e, "coat", "a\x00b"), "value must be a text of 1 to 120 printable characters"),
        (lambda e: say(e, "coat", "x" * 121), "value must be a text of 1 to 120 printable characters"),
        (lambda e: say(e, "coat", ["red"]), "value must be a text of 1 to 120 printable characters"),
        (lambda e: say(e, "n'ame", "red"), "name must be 1 to 40 letters"),
        (lambda e: join(e, "conversation", "p1", "p1"), "joins two different entities"),
        (lambda e: join(e, "conversation", observation="o2"), "p1 has no sighting at frame 000030"),
        (lambda e: join(e, "x" * 121), "name must be a text of 1 to 120 printable characters"),
        (lambda e: e.add("add_relation", None, 1), "the call must be an object"),
    ],
)
def test_a_refused_write_leaves_its_line_and_nothing_else(graph, call, why):
    episode, writes = begin(graph)
    episode.plan(PLAN, 0)
    seen_twice(episode, 15)
    episode.observed(look(30), 0)
    before = tables_of(graph, belongs(episode.key))
    result = call(episode)
    assert not result.accepted and why in result.text
    after = tables_of(graph, belongs(episode.key))
    (line,) = [row for row in after.pop("Write") if row not in before["Write"]]
    assert (line["accepted"], line["reason"]) == (False, result.text) == (writes[-1].accepted, writes[-1].reason)
    assert len(after.pop("Wrote")) == len(before["Wrote"]) + 1
    assert after == {table: rows for table, rows in before.items() if table not in ("Write", "Wrote")}


def test_boxes_are_put_into_the_panorama(graph, episode):
    episode.observed(look(0, 0.0), 0)
    episode.observed(whole(15), 0)
    assert add(episode, box=Box(230.0, 10, 20, 30)).accepted
    assert add(episode, observation="o2", box=Box(3750.0, 10, 10, 30)).accepted
    over_seam, plain = edges_of(graph, "Sighted", episode.key)
    assert over_seam["box"] == {"x": 3520.0 + 230.0, "y": 10.0, "w": 20.0, "h": 30.0} and over_seam["angle"] == 0.0
    assert plain["box"]["x"] == 3750.0 and plain["angle"] == pytest.approx(3755 / 3760 * 360)
    first, second = sorted(rows_of(graph, "Observation", belongs(episode.key)), key=lambda row: row["number"])
    assert (first["left"], first["width"]) == (3520, 480) and (second["left"], second["width"]) == (0, 3760)
    assert shown_graph(episode.rows())["observations"] == [
        {"observation": "o1", "frame_id": "000000", "angle_deg": 0.0},
        {"observation": "o2", "frame_id": "000015", "panorama": True},
    ]


def test_the_plan_becomes_slots(graph, episode):
    validate(PLAN)
    episode.plan(PLAN, 0)
    slots = sorted(rows_of(graph, "Slot", belongs(episode.key)), key=lambda row: row["number"])
    assert [tuple(slot[c] for c in ("kind", "node", "other", "name", "value", "frame")) for slot in slots] == [
        ("node", "a", "", "", "", -1),
        ("condition", "a", "", "gender", "female", -1),
        ("condition", "a", "", "group_size", "3", 15),
        ("condition", "a", "", "object", "holding: bag", 15),
        ("condition", "a", "", "action", "walking", 30),
        ("condition", "a", "", "interaction", "hugging", 15),
        ("node", "b", "", "", "", -1),
        ("edge", "a", "b", "conversation", "", 15),
        ("read", "b", "", "presence", "t0, t1", 15),
    ]


def test_a_later_claim_takes_a_node(graph, episode):
    episode.plan(PLAN, 0)
    episode.observed(look(15), 0)
    for name, node in (("p1", "a"), ("p2", "b"), ("p2", "a"), ("p1", None)):
        assert add(episode, name, node=node).accepted
    people = {row["name"]: row["node"] for row in rows_of(graph, "Entity", belongs(episode.key))}
    assert people == {"p1": "", "p2": "a"}
    assert [entity.get("node") for entity in shown_graph(episode.rows())["entities"]] == [None, "a"]


def test_gender_holds_always_and_poses_at_their_frame(graph, episode):
    seen_twice(episode, 15, 30)
    for name, value, observation in (
        ("gender", "male", "o1"),
        ("gender", "female", "o2"),
        ("action", "walking", "o1"),
        ("action", "reading", "o1"),
        ("action", "standing", "o1"),
        ("action", "walking", "o2"),
        ("Distance M", 2, "o1"),
        ("distance_m", 3, "o1"),
    ):
        assert say(episode, name, value, observation=observation).accepted
    shown = shown_graph(episode.rows())["entities"][0]["attributes"]
    assert shown == [
        {"name": "gender", "value": "female", "observation": "o2"},
        {"name": "action", "value": "reading", "frame_id": "000015", "observation": "o1"},
        {"name": "action", "value": "standing", "frame_id": "000015", "observation": "o1"},
        {"name": "action", "value": "walking", "frame_id": "000030", "observation": "o2"},
        {"name": "distance_m", "value": 3.0, "frame_id": "000015", "observation": "o1"},
    ]
    old = [(row["name"], row["value"]) for row in edges_of(graph, "Has", episode.key) if not row["current"]]
    assert old == [("gender", "male"), ("action", "walking"), ("distance_m", "2")]


def test_a_relation_that_holds_shift_frames_is_one(graph, episode):
    seen_twice(episode, 15, people=("p1", "p2", "p3"))
    for source, name, target in (
        ("p1", "Conversation", "p2"),
        ("p2", "conversation", "p1"),
        ("p1", FIRST_LEFT, "p2"),
        ("p2", FIRST_LEFT, "p1"),
        ("p1", FIRST_LEFT, "p3"),
    ):
        assert join(episode, name, source, target).accepted
    shown = [(r["source"], r["name"], r["target"]) for r in shown_graph(episode.rows())["relations"]]
    assert shown == [("p2", "conversation", "p1"), ("p2", FIRST_LEFT, "p1"), ("p1", FIRST_LEFT, "p3")]


def test_what_was_believed_at_a_step_can_be_asked(graph, episode):
    seen_twice(episode, 15)
    for step, value in ((3, "male"), (5, "female")):
        assert say(episode, "gender", value, step=step).accepted
    at = (
        "MATCH (:Episode {id: $episode})-[:Holds]->(n:Entity)-[r:Has]->(:Observation) "
        "WITH n, r WHERE r.step <= $step AND r.until > $step RETURN r.value AS value ORDER BY value"
    )
    believed = [graph.query(at, {"episode": episode.key, "step": step})["value"].to_pylist() for step in range(2, 7)]
    assert believed == [[], ["male"], ["male"], ["female"], ["female"]]


def test_there_is_an_end_of_entities_and_writes(graph, episode, monkeypatch):
    episode.observed(look(15), 0)
    assert all(add(episode, f"p{number}").accepted for number in range(MOST_ENTITIES))
    assert "no more are taken" in add(episode, "one-more").text
    assert add(episode, "p1").accepted
    assert MOST_WRITES == 2000
    monkeypatch.setattr("jrdb_avr.agent.beliefs.world_model.MOST_WRITES", MOST_ENTITIES + 1)
    assert "no more are taken" in say(episode, "coat", "red").text


def test_an_interrupted_try_is_taken_away(graph):
    first, _ = begin(graph, 7)
    first.plan(PLAN, 0)
    seen_twice(first, 15)
    assert join(first, "conversation").accepted
    others = tables_of(graph, lambda row: not belongs(first.key)(row))
    second, writes = begin(graph, 7)
    assert not any(tables_of(graph, belongs(second.key)).values())
    second.settle()
    tables = tables_of(graph, belongs(second.key))
    assert {table: len(rows) for table, rows in tables.items() if rows} == {"Episode": 1, "Write": 1, "Wrote": 1}
    assert tables == replay(writes, second.key)
    assert tables_of(graph, lambda row: not belongs(first.key)(row)) == others
    assert shown_graph(second.rows()) == {"observations": [], "entities": [], "relations": [], "missing": []}


# -- side by side -----------------------------------------------------------------------------------------------------


def script(episode, frames=(0, 15, 30), barrier=None):
    """Calls of a question, ten at each frame, with replacements and refusals among them."""
    for frame in frames:
        if barrier:
            barrier.wait()
        name = episode.observed(look(frame), frame)
        for person in ("p1", "p2"):
            add(episode, person, name, step=frame)
            say(episode, "gender", "female", person, name, frame)
            say(episode, "action", POSES[frame % 2], person, name, frame)
        join(episode, "conversation", observation=name, step=frame)
        join(episode, "conversation", "p1", "p9", observation=name, step=frame)


def unnamed(tables, key):
    text = json.dumps(tables).replace(hash_of(key), "HASH")
    return json.loads(text.replace(key, "KEY").replace(question_of(key), "QUESTION"))


def question_of(key):
    return key.partition("/")[2]


def test_two_threads_keep_to_their_own_episode(graph):
    (first, _), (second, _) = begin(graph, 21), begin(graph, 22)
    barrier = threading.Barrier(2)
    threads = [threading.Thread(target=script, args=(episode, (0, 15, 30), barrier)) for episode in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    one, two = (unnamed(tables_of(graph, belongs(e.key)), e.key) for e in (first, second))
    assert one == two and len(one["Has"]) == 12 and len(one["Related"]) == 3
