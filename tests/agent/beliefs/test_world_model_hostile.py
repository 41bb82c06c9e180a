"""Whatever an agent calls: nothing ungrounded is written, and nobody else's beliefs are touched."""

import json
import math
import random

import environment
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from world_calls import PLAN, VICTIM, begin, believe, belongs, beside_scene, calls_of, play, replay, rows_of, tables_of

from jrdb_avr.agent.beliefs.display import shown_graph
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.beliefs import ALWAYS
from jrdb_avr.schema.labels import INTERACTIONS, POSES
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """World tables beside a scene, and in them an episode that nobody else may touch."""
    with beside_scene(tmp_path_factory.mktemp("world")) as world:
        believe(world, 999)
        yield world


@settings(max_examples=environment.examples(10), phases=(Phase.explicit, Phase.generate))
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
    check_shown(shown_graph(episode.rows()), tables)
    assert tables == replay(writes, episode.key)
    assert len(tables["Write"]) == len(writes) == 2 + len(calls)
    for text in [result.text for result in said] + [json.dumps(shown_graph(episode.rows())).replace("secret/1", "")]:
        assert "secret/" not in text.replace("secret/1", "")
        text.encode()


UNGROUNDED = {
    "an edge of another episode than its entity or its look": "MATCH (n:Entity)-[r:Sighted|Has]->(o:Observation) "
    "WHERE r.episode <> n.episode OR o.episode <> n.episode RETURN count(*) AS n",
    "a look that its episode did not make": "MATCH (n:Entity)-[r:Sighted|Has]->(o:Observation) "
    "WHERE NOT EXISTS { MATCH (e:Episode)-[:Made]->(o) WHERE e.id = n.episode } RETURN count(*) AS n",
    "a sighting at another frame than its look's": "MATCH (n:Entity)-[r:Sighted]->(o:Observation) "
    "WHERE r.frame <> o.frame RETURN count(*) AS n",
    "a belief about somebody who is not sighted at the look's frame": "MATCH (n:Entity)-[r:Has]->(o:Observation) "
    "WHERE NOT EXISTS { MATCH (n)-[s:Sighted]->(:Observation) WHERE s.frame = o.frame } RETURN count(*) AS n",
    # In stitched pixels, which go on beyond the seam.
    "a box outside its look": "MATCH (n:Entity)-[r:Sighted]->(o:Observation) WHERE NOT (r.box.x >= o.left "
    "AND r.box.y >= 0.0 AND r.box.w > 0.0 AND r.box.x + r.box.w <= o.left + o.width + 0.001 AND r.box.h > 0.0 "
    "AND r.box.y + r.box.h <= 480.001) RETURN count(*) AS n",
    "a number that is none": "MATCH (:Entity)-[r:Has]->(:Observation) "
    "WHERE NOT (r.number >= -1e308 AND r.number <= 1e308) RETURN count(*) AS n",
    "a relation of two episodes, or of one with itself": "MATCH (n:Entity)-[r:Related]->(m:Entity) "
    "WHERE n.episode <> m.episode OR r.episode <> n.episode OR n.id = m.id RETURN count(*) AS n",
}
"""Statements that count what nothing may be."""
RELATED = (
    "MATCH (n:Entity)-[r:Related]->(m:Entity) RETURN r.observation AS look, r.first AS frame, n.id AS source, "
    "m.id AS target, n.episode AS episode"
)
MADE = "MATCH (e:Episode)-[:Made]->(o:Observation) RETURN e.id AS episode, o.id AS look, o.frame AS frame"
SEEN = "MATCH (n:Entity)-[s:Sighted]->(:Observation) RETURN DISTINCT n.id AS who, s.frame AS frame"


@pytest.mark.slow
def test_ten_thousand_calls_write_nothing_that_names_no_observation_made():
    rng = random.Random(19)
    with WorldGraph.memory() as world:
        believe(world, 999)
        episodes, calls = 20, 500
        said = []
        for number in range(episodes):
            episode, writes = begin(world, number)
            episode.plan(PLAN, 0)
            with episode.together():
                said += play(episode, calls_of(rng, calls))
            looks = [write for write in writes if write.tool == "observe"]
            assert len(rows_of(world, "Observation", belongs(episode.key))) == len(looks)
        written = world.query("MATCH (w:Write) WHERE w.accepted = true RETURN count(*) AS n")["n"][0].as_py()
        assert written > 2000 and sum(not one.accepted for one in said) > 2000, "both happen often"
        for what, statement in UNGROUNDED.items():
            assert world.query(statement)["n"].to_pylist() == [0], what
        made = {tuple(row.values()) for row in world.query(MADE, ordered=False).to_pylist()}
        seen = {tuple(row.values()) for row in world.query(SEEN, ordered=False).to_pylist()}
        related = world.query(RELATED, ordered=False).to_pylist()
        assert len(related) > 500
        for row in related:
            assert (row["episode"], row["look"], row["frame"]) in made
            assert {(row["source"], row["frame"]), (row["target"], row["frame"])} <= seen


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
    shift_frames = later["name"] in (*INTERACTIONS, SAME_GROUP)
    return later["name"] == earlier["name"] and (ends == before or (shift_frames and ends == before[::-1]))


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
