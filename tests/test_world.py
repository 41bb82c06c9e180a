"""The agent's world model: the grounding rule, what replaces what, and episodes side by side."""

import json
import math
import random
import threading
from concurrent.futures import ThreadPoolExecutor

import effort
import pyarrow as pa
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from test_world_graph import SCENE, believe
from world_play import begin, belongs, look, rows_of, tables_of, whole

from jrdb_avr.agent.world import MOST_ENTITIES, MOST_WRITES
from jrdb_avr.queries.handle import build_graph
from jrdb_avr.queries.world import WorldGraph
from jrdb_avr.queries.world_record import replayed
from jrdb_avr.schema.graph import scene_ddl
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time, validate
from jrdb_avr.schema.tables import RUNS
from jrdb_avr.schema.vocabulary import FIRST_LEFT, INTERACTIONS, POSES, SAME_GROUP
from jrdb_avr.schema.world import ALWAYS

PLAN = Plan(
    "a",
    "b",
    {"t0": Time(frame=15), "t1": Time(frame=30)},
    (
        Node(
            "a",
            (
                Condition(attribute="gender", value="female"),
                Condition(attribute="group_size", value=3, at="t0"),
                Condition(object="bag", verb="holding", at="t0"),
                Condition(action="walking", at="t1"),
                Condition(interaction="hugging", at="t0"),
            ),
        ),
        Node("b"),
    ),
    (Edge("a", "conversation", "b", "t0"),),
    AnswerSpec("multiple_choice", "presence", "b", ("t0", "t1")),
)
BOX = Box(10.0, 20.0, 30.0, 40.0)


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """World tables beside a scene, and in them an episode that nobody else may touch."""
    path = tmp_path_factory.mktemp("world") / "graph.kuzu"
    with build_graph(path) as built:
        for statement in (*scene_ddl(), *SCENE):
            built.execute(statement)
    with WorldGraph.open(path) as world:
        believe(world, 999)
        yield world


@pytest.fixture
def episode(graph):
    return begin(graph)[0]


def add(episode, name="p1", observation="o1", box=BOX, step=1, **more):
    given = {"id": name, "kind": "person", "observation": observation, "box": [1, 2, 3, 4], **more}
    return episode.add_entity(given, box, step)


def say(episode, name, value, entity="p1", observation="o1", step=1):
    return episode.add_attribute({"entity": entity, "name": name, "value": value, "observation": observation}, step)


def join(episode, name, source="p1", target="p2", observation="o1", step=1):
    given = {"source": source, "name": name, "target": target, "observation": observation}
    return episode.add_relation(given, step)


def seen_twice(episode, *frames, people=("p1", "p2")):
    """Observations of frames in which all people are sighted."""
    for frame in frames:
        name = episode.observed(look(frame), 0)
        for person in people:
            assert add(episode, person, name).accepted


def edges_of(graph, table, key):
    return sorted(rows_of(graph, table, belongs(key)), key=lambda row: row["write"])


# -- whatever is called -----------------------------------------------------------------------------------------------

VICTIM = "run/" + f"{999:016x}"
INJECTED = (
    "'}) DETACH DELETE n //",
    "`",
    "\\",
    "$id",
    "p1'",
    "{id}",
    "secret/1",
    VICTIM,
    f"{VICTIM}/p1",
    f"{VICTIM}/o1",
)
ODD = ("", " ", "\x00", "\ud800", "\u202e", "p" * 33, "x" * 5000, "о1", "nan", "o01", "o0", "o-1", "1")
JUNK = (
    *(None, True, 0, -1, 10**400, 2**63, -(2**70), 0.5, math.nan, math.inf, -math.inf, 1e308),
    *([], [[]], {}, {"a": {"b": [None, "\ud800"]}}, [1, 2, 3, 4], {1: 2}, (1,), b"x", {"x"}),
    *INJECTED,
    *ODD,
)
RELATIONS = ("conversation", "Walking_Together", SAME_GROUP, FIRST_LEFT, "front left, close", "front, far", "stands by")
ATTRIBUTES = (
    ("gender", "female"),
    ("gender", "Male"),
    ("age", "young adulthood"),
    ("action", "walking"),
    ("action", "standing"),
    ("Action", "holding something"),
    ("group_size", 3),
    ("distance_m", 2.5),
    ("sector", "left"),
    ("object", "holding: bag"),
    ("interaction", "hugging"),
    ("coat", "red'); MATCH (n) DETACH DELETE n"),
    ("steps", 4),
    ("gender", "secret"),
    ("object", "bag"),
)
EDGES = (-1.0, 0.0, 5.0, 480.0, 3760.0, 1e300, math.nan, math.inf, -math.inf)
SCAFFOLD = [
    ("observed", 15, 180.0),
    ("observed", 30, 0.0),
    ("observed", 15, 350.0),
    *(("add_entity", {"id": p, "kind": "person", "observation": "o1", "box": []}, BOX) for p in ("p1", "p2")),
    ("add_entity", {"id": "p3", "kind": "person", "observation": "o2", "box": []}, BOX),
]
"""Observations and people that calls may name, so that many of them are grounded."""


def calls_of(rng):
    """Thirty calls: good ones, good ones with one part replaced, added or left out, and junk."""
    return [*SCAFFOLD, *(_call(rng) for _ in range(30))]


def _call(rng):
    observation = rng.choice(("o1", "o1", "o2", "o2", "o3", "o3", "o4", f"{VICTIM}/o1"))
    one, two = rng.sample(("p1", "p2", "p3"), 2)
    name, value = rng.choice(ATTRIBUTES)
    match rng.randrange(12):
        case 0:
            return "observed", rng.choice((0, 15, 30)), rng.choice((0.0, 180.0, 350.0, None))
        case 1:
            return "noted", rng.choice(JUNK), rng.random() < 0.5, _text(rng)
        case 2:
            return "refused", rng.choice(JUNK), _text(rng)
        case 3 | 4 | 5:
            good = {"id": one, "kind": "person", "observation": observation, "box": [1, 2, 3, 4]}
            if rng.random() < 0.5:
                good["node"] = rng.choice(("a", "b", None, "c"))
            odd = (Box(*rng.choices(EDGES, k=4)), "the box is unreadable", Box(470.0, 0.0, 10.0, 480.0000000001))
            return "add_entity", _wild(rng, good), BOX if rng.random() < 0.7 else rng.choice(odd)
        case 6 | 7 | 8:
            good = {"entity": one, "name": name, "value": value, "observation": observation}
            return "add_attribute", _wild(rng, good)
        case _:
            good = {"source": one, "name": rng.choice(RELATIONS), "target": two, "observation": observation}
            return "add_relation", _wild(rng, good)


def _wild(rng, good):
    junk = rng.choice((_text(rng), *JUNK))
    match rng.randrange(10):
        case 0:
            return junk
        case 1 | 2:
            return good | {rng.choice(sorted(good.keys() - {"box"})): junk}
        case 3:
            return good | {_text(rng): junk}
        case 4:
            return {key: value for key, value in good.items() if key != rng.choice(sorted(good))}
    return good


def _text(rng):
    return "".join(chr(rng.choice((rng.randrange(128), rng.randrange(0x110000)))) for _ in range(rng.randrange(12)))


def play(episode, calls):
    """Make the calls, each in a step of its own; what was said to each write."""
    said = []
    for step, (tool, *values) in enumerate(calls, 1):
        match tool:
            case "observed":
                frame, angle = values
                episode.observed(whole(frame) if angle is None else look(frame, angle), step)
            case "noted":
                episode.noted("get_graph", values[0], step, *values[1:])
            case "refused":
                said.append(episode.refused("final_answer", *values, step))
            case _:
                said.append(getattr(episode, tool)(*values, step))
    return said


@settings(max_examples=effort.examples(10), phases=(Phase.explicit, Phase.generate))
@given(st.integers(0, 2**32))
def test_whatever_is_called_nothing_ungrounded_is_written(graph, seed):
    calls = calls_of(random.Random(seed))
    others = tables_of(graph, belongs(VICTIM))
    episode, writes = begin(graph)
    episode.plan(PLAN, 0)
    said = play(episode, calls)
    assert tables_of(graph, belongs(VICTIM)) == others
    tables = tables_of(graph, belongs(episode.key))
    check_grounded(tables, episode.key)
    check_writes(writes)
    check_current(tables)
    check_shown(episode.graph(), tables)
    assert tables == replay(writes, episode.key)
    assert len(tables["Write"]) == len(writes) == 2 + len(calls)
    for text in [result.said for result in said] + [json.dumps(episode.graph()).replace("secret/1", "")]:
        assert "secret/" not in text.replace("secret/1", "")
        text.encode()


def check_grounded(tables, key):
    """Every fact hangs on an observation that its own episode made, and on nothing else."""
    made = {row["id"]: row for row in tables["Observation"]}
    held = {row["id"] for row in tables["Entity"]}
    assert all(name.startswith(f"{key}/") for name in (*made, *held))
    sighted = {(row["source"], row["frame"]) for row in tables["Sighted"]}
    for row in tables["Sighted"]:
        assert row["source"] in held and row["frame"] == made[row["target"]]["frame"]
        assert all(math.isfinite(row["box"][side]) for side in "xywh") and 0 <= row["angle"] < 360
        assert row["box"]["w"] > 0 and row["box"]["h"] > 0
    for row in tables["Has"]:
        frame = made[row["target"]]["frame"]
        assert row["source"] in held and (row["source"], frame) in sighted and math.isfinite(row["number"])
        always = row["name"] in ("gender", "age")
        assert (row["first"], row["last"]) == ((0, ALWAYS) if always else (frame, frame))
    for row in tables["Related"]:
        frame = made[row["observation"]]["frame"]
        assert row["source"] != row["target"] and (row["first"], row["last"]) == (frame, frame)
        assert {(row["source"], frame), (row["target"], frame)} <= sighted


def check_writes(writes):
    """What was accepted named an observation that was made before it; what was refused put nothing into the graph."""
    made = 0
    for number, write in enumerate(writes):
        assert write.number == number
        if write.tool == "observe":
            made += 1
        if write.tool.startswith("add_") and write.accepted:
            assert json.loads(write.arguments)["observation"] in {f"o{n}" for n in range(1, made + 1)}
            assert write.fact and not write.reason
        elif write.tool != "begin" and not write.accepted:
            assert not write.fact
        json.loads(write.arguments)


def replaces(table, later, earlier):
    """Whether a fact takes the place of an earlier one, by the words of the contract."""
    if table == "Sighted":
        return later["source"] == earlier["source"] and later["frame"] == earlier["frame"]
    if (later["first"], later["last"]) != (earlier["first"], earlier["last"]):
        return False
    if table == "Has":
        if (later["source"], later["name"]) != (earlier["source"], earlier["name"]):
            return False
        if later["name"] not in ("action", "interaction", "object"):
            return True
        poses = later["name"] == "action" and {later["value"], earlier["value"]} <= set(POSES)
        return poses or later["value"] == earlier["value"]
    ends = (later["source"], later["target"])
    before = (earlier["source"], earlier["target"])
    if later["name"] == earlier["name"] == FIRST_LEFT:
        return ends[0] == before[0]
    if {later["name"], earlier["name"]} <= {"front left, close", "front, far"}:
        return ends == before
    both_ways = later["name"] in (*INTERACTIONS, SAME_GROUP)
    return later["name"] == earlier["name"] and (ends == before or (both_ways and ends == before[::-1]))


def check_current(tables):
    """A fact is current until the first later one that takes its place."""
    for table in ("Sighted", "Has", "Related"):
        rows = sorted(tables[table], key=lambda row: row["write"])
        for at, row in enumerate(rows):
            after = [later for later in rows[at + 1 :] if replaces(table, later, row)]
            assert row["current"] == (not after)
            assert row["until"] == (after[0]["step"] if after else ALWAYS)


def check_shown(shown, tables):
    """What `get_graph` shows is what the tables hold."""
    name = {row["id"]: row["name"] for row in tables["Entity"]}

    def current(table):
        return sorted((row for row in tables[table] if row["current"]), key=lambda row: row["write"])

    def observation(key):
        return key.rpartition("/")[2]

    assert [(o["observation"], int(o["frame_id"])) for o in shown["observations"]] == [
        (f"o{row['number']}", row["frame"]) for row in sorted(tables["Observation"], key=lambda row: row["number"])
    ]
    assert [(e["id"], e["kind"], e.get("node", "")) for e in shown["entities"]] == [
        (row["name"], row["kind"], row["node"]) for row in sorted(tables["Entity"], key=lambda row: row["number"])
    ]
    nodes = [row["node"] for row in tables["Entity"] if row["node"]]
    assert len(nodes) == len(set(nodes))
    for entity in shown["entities"]:
        sightings = [row for row in current("Sighted") if name[row["source"]] == entity["id"]]
        assert entity["sightings"] == [
            {
                "observation": observation(row["target"]),
                "frame_id": f"{row['frame']:06d}",
                "angle_deg": round(row["angle"], 1),
                "box": [round(row["box"][side], 1) for side in "xywh"],
            }
            for row in sightings
        ]
        attributes = [row for row in current("Has") if name[row["source"]] == entity["id"]]
        assert [(a["name"], str(a["value"]).removesuffix(".0"), a["observation"]) for a in entity["attributes"]] == [
            (row["name"], row["value"], observation(row["target"])) for row in attributes
        ]
        assert [a.get("frame_id") for a in entity["attributes"]] == [
            None if row["last"] == ALWAYS else f"{row['first']:06d}" for row in attributes
        ]
    assert shown["relations"] == [
        {
            "source": name[row["source"]],
            "name": row["name"],
            "target": name[row["target"]],
            "frame_id": f"{row['first']:06d}",
            "observation": observation(row["observation"]),
        }
        for row in current("Related")
    ]


def replay(writes, key):
    """The rows of the tables as the record alone gives them."""
    run, question_id = key.split("/")
    columns = ("number", "step", "tool", "arguments", "accepted", "reason", "fact")
    rows = [{"run_id": run, "question_id": question_id, **{c: getattr(w, c) for c in columns}} for w in writes]
    tables = replayed(pa.Table.from_pylist(rows, RUNS["world"]))
    renamed = {"from": "source", "to": "target"}
    return {
        name: sorted(
            ({renamed.get(column, column): value for column, value in row.items()} for row in rows.to_pylist()),
            key=repr,
        )
        for name, rows in tables.items()
    }


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
        (lambda e: e.add_relation(None, 1), "the call must be an object"),
    ],
)
def test_a_refused_write_leaves_its_line_and_nothing_else(graph, call, why):
    episode, writes = begin(graph)
    episode.plan(PLAN, 0)
    seen_twice(episode, 15)
    episode.observed(look(30), 0)
    before = tables_of(graph, belongs(episode.key))
    result = call(episode)
    assert not result.accepted and why in result.said
    after = tables_of(graph, belongs(episode.key))
    (line,) = [row for row in after.pop("Write") if row not in before["Write"]]
    assert (line["accepted"], line["reason"]) == (False, result.said) == (writes[-1].accepted, writes[-1].reason)
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
    assert episode.graph()["observations"] == [
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
    assert [entity.get("node") for entity in episode.graph()["entities"]] == [None, "a"]


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
    shown = episode.graph()["entities"][0]["attributes"]
    assert shown == [
        {"name": "gender", "value": "female", "observation": "o2"},
        {"name": "action", "value": "reading", "frame_id": "000015", "observation": "o1"},
        {"name": "action", "value": "standing", "frame_id": "000015", "observation": "o1"},
        {"name": "action", "value": "walking", "frame_id": "000030", "observation": "o2"},
        {"name": "distance_m", "value": 3.0, "frame_id": "000015", "observation": "o1"},
    ]
    old = [(row["name"], row["value"]) for row in edges_of(graph, "Has", episode.key) if not row["current"]]
    assert old == [("gender", "male"), ("action", "walking"), ("distance_m", "2")]


def test_a_relation_that_holds_both_ways_is_one(graph, episode):
    seen_twice(episode, 15, people=("p1", "p2", "p3"))
    for source, name, target in (
        ("p1", "Conversation", "p2"),
        ("p2", "conversation", "p1"),
        ("p1", FIRST_LEFT, "p2"),
        ("p2", FIRST_LEFT, "p1"),
        ("p1", FIRST_LEFT, "p3"),
    ):
        assert join(episode, name, source, target).accepted
    shown = [(r["source"], r["name"], r["target"]) for r in episode.graph()["relations"]]
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
    assert "no more are taken" in add(episode, "one-more").said
    assert add(episode, "p1").accepted
    assert MOST_WRITES == 2000
    monkeypatch.setattr("jrdb_avr.agent.world.MOST_WRITES", MOST_ENTITIES + 1)
    assert "no more are taken" in say(episode, "coat", "red").said


def test_an_interrupted_try_is_taken_away(graph):
    first, _ = begin(graph, 7)
    first.plan(PLAN, 0)
    seen_twice(first, 15)
    assert join(first, "conversation").accepted
    others = tables_of(graph, lambda row: not belongs(first.key)(row))
    second, writes = begin(graph, 7)
    tables = tables_of(graph, belongs(second.key))
    assert {table: len(rows) for table, rows in tables.items() if rows} == {"Episode": 1, "Write": 1, "Wrote": 1}
    assert tables == replay(writes, second.key)
    assert tables_of(graph, lambda row: not belongs(first.key)(row)) == others
    assert second.graph() == {"observations": [], "entities": [], "relations": [], "missing": []}


def test_long_and_unreadable_arguments_are_kept_as_texts(episode):
    deep = []
    for _ in range(100_000):
        deep = [deep]
    for arguments in (deep, {"id": "x" * 10**6}, {"id": 10**5000}, {"id": {1, 2}}, {"id": math.nan}):
        assert not episode.add_entity(arguments, BOX, 1).accepted
    while deep:
        deep = deep[0]


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
    return json.loads(json.dumps(tables).replace(key, "KEY").replace(question_of(key), "QUESTION"))


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


def test_sixty_four_episodes_at_once():
    with WorldGraph.memory() as graph:

        def played(number):
            episode, writes = begin(graph, number)
            script(episode, (15,))
            return episode.key, writes

        with ThreadPoolExecutor(64) as pool:
            found = list(pool.map(played, range(64)))
        tables = tables_of(graph)
        assert len(tables["Episode"]) == 64
        key, writes = found[0]
        alone = unnamed(replay(writes, key), key)
        for key, writes in found:
            assert unnamed(replay(writes, key), key) == alone
        assert {table: len(rows) for table, rows in tables.items()} == {t: 64 * len(r) for t, r in alone.items()}
        assert sorted(map(repr, tables["Has"])) == sorted(
            repr(row) for key, writes in found for row in replay(writes, key)["Has"]
        )
