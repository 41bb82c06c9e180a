"""The kept queries against DuckDB, which computes the same from the interval tables."""

import contextlib
import random
from pathlib import Path

import duckdb
import pytest
from belief_runs import BELIEF_QUERIES
from random_worlds import random_world
from worlds import load_world

import jrdb_avr
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.named import named_queries
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.graph import scene_ddl
from jrdb_avr.schema.tables import INTERVALS

FIRST, SECOND = "sample-plaza-01_0", "sample-cafe-02_0"
RIGHT = "first to the right of (robot view)"

# One statement per kept query, over the views of the interval tables; $s, $f and $t are sequence, frame and track.
EXPECTED = {
    "who_is_where": """
        SELECT g.track, gender, pose, round(angle, 1) AS angle, sector, round(distance, 1) AS m,
               group_size AS group_of, clear
        FROM intervals_sightings g JOIN intervals_persons p USING (sequence, track)
        WHERE sequence = $s AND frame = $f""",
    "busiest_frames": """
        SELECT sequence, frame, round(f.seconds, 2) AS seconds, count(*) AS people,
               count(*) FILTER (WHERE clear) AS clearly_seen
        FROM intervals_sightings JOIN intervals_frames f USING (sequence, frame) WHERE keyframe GROUP BY ALL
        ORDER BY people DESC, sequence, frame LIMIT 20""",
    "groups": """
        SELECT cluster, count(*) AS size, list(track ORDER BY track) AS members
        FROM intervals_memberships WHERE sequence = $s AND $f BETWEEN first AND last AND certain GROUP BY cluster""",
    "neighbors": """
        SELECT label AS place, target AS track, first, last, certain
        FROM intervals_beside WHERE sequence = $s AND source = $t AND $f BETWEEN first AND last""",
    "left_to_right": f"""
        WITH step AS (SELECT source, target FROM intervals_beside WHERE sequence = $s AND label = '{RIGHT}'
                      AND certain AND $f BETWEEN first AND last)
        SELECT a.source AS track, a.target AS first_right, b.target AS then_right
        FROM step a LEFT JOIN step b ON b.source = a.target""",
    "passes_behind": """
        SELECT track, min(frame) AS first, max(frame) AS last, count(*) AS frames, round(min(distance), 1) AS nearest_m
        FROM intervals_sightings WHERE sequence = $s AND sector = 'behind' GROUP BY track""",
    "sequences": """
        SELECT sequence, frame_count AS frames,
               (SELECT count(*) FROM intervals_persons p WHERE p.sequence = s.sequence) AS people,
               (SELECT count(*) FROM (SELECT cluster FROM intervals_memberships m WHERE m.sequence = s.sequence
                UNION SELECT cluster FROM intervals_group_info i WHERE i.sequence = s.sequence)) AS groups,
               action_step, layers
        FROM intervals_sequence s""",
    "timeline": """
        SELECT first, last, 'does' AS what, action AS name, '' AS of, certain
        FROM intervals_actions WHERE sequence = $s AND track = $t
        UNION ALL SELECT first, last, 'is in', 'group', cluster::VARCHAR, certain
        FROM intervals_memberships WHERE sequence = $s AND track = $t
        UNION ALL SELECT first, last, 'with', label, target::VARCHAR, certain
        FROM intervals_interactions WHERE sequence = $s AND source = $t
        UNION ALL SELECT first, last, 'handles', verb, coalesce(category, '?') || ' ' || object::VARCHAR, certain
        FROM (SELECT h.*, o.category
              FROM intervals_handles h JOIN intervals_objects o USING (sequence, object, category_id))
        WHERE sequence = $s AND track = $t""",
    "conversations": """
        SELECT least(source, target) AS track, greatest(source, target) AS partner,
               round(sum(last_s - first_s) / 2, 1) AS seconds, count(*) // 2 AS talks, min(first) AS first,
               max(last) AS last
        FROM intervals_interactions WHERE sequence = $s AND label = 'conversation' AND certain GROUP BY 1, 2""",
    "longest_conversations": """
        SELECT sequence, source AS track, target AS partner, first, last, round(last_s - first_s, 1) AS seconds
        FROM intervals_interactions WHERE label = 'conversation' AND certain AND source < target
        ORDER BY seconds DESC, sequence, track, partner, first LIMIT 20""",
    "group_changes": """
        WITH beside AS (
            SELECT *, lag(last) OVER w AS before, lead(first) OVER w AS after,
                   (SELECT action_step FROM intervals_sequence WHERE sequence = $s) AS step
            FROM (FROM intervals_memberships UNION ALL BY NAME FROM intervals_possible_memberships)
            WHERE sequence = $s WINDOW w AS (PARTITION BY track, cluster ORDER BY first))
        SELECT first AS frame, 'joins' AS change, cluster, track, certain
        FROM beside WHERE gap IS NULL AND (before IS NULL OR before + step < first)
        UNION ALL SELECT last, 'leaves', cluster, track, certain
        FROM beside WHERE gap IS NULL AND (after IS NULL OR after - step > last)""",
    "things_handled": """
        SELECT track, verb, category, object AS thing, min(h.first) AS first,
               round(sum(last_s - first_s), 1) AS seconds
        FROM intervals_handles h JOIN intervals_objects o USING (sequence, object, category_id)
        WHERE sequence = $s AND certain GROUP BY track, verb, category, object, category_id""",
    "looks_at_robot": """
        SELECT track, count(*) AS times, min(first) AS first, max(last) AS last,
               round(sum(last_s - first_s), 1) AS seconds
        FROM intervals_actions WHERE sequence = $s AND action = 'looking at robot' AND certain GROUP BY track""",
    "seen_together": """
        WITH here AS (SELECT track, frame FROM intervals_sightings JOIN intervals_frames f USING (sequence, frame)
                      WHERE sequence = $s AND f.keyframe AND clear)
        SELECT a.track, b.track AS other, count(*) AS keyframes, min(a.frame) AS first, max(a.frame) AS last
        FROM here a JOIN here b ON a.frame = b.frame AND a.track < b.track GROUP BY 1, 2
        ORDER BY keyframes DESC, 1, 2 LIMIT 20""",
    "unknown_facts": """
        SELECT action, count(*) AS intervals, sum(last - first + 1)::BIGINT AS frames,
               count(DISTINCT track) AS people
        FROM intervals_actions WHERE sequence = $s AND NOT certain GROUP BY action""",
    "demographics_by_group": """
        SELECT cluster, (SELECT any_value(value) FROM intervals_group_info i WHERE i.sequence = m.sequence
                         AND i.cluster = m.cluster AND attribute = 'venue' AND chosen) AS venue,
               gender, age, count(DISTINCT track) AS people
        FROM intervals_memberships m JOIN intervals_persons USING (sequence, track)
        WHERE sequence = $s AND certain GROUP BY ALL""",
    "things_in_view": """
        SELECT category, object AS thing, round(angle, 1) AS angle, round(x, 1) AS x, round(y, 1) AS y,
               round(w, 1) AS w, round(h, 1) AS h
        FROM intervals_object_sightings JOIN intervals_objects USING (sequence, object, category_id)
        WHERE sequence = $s AND frame = $f""",
    "present_when": """
        SELECT first, last, round(last_s - first_s, 1) AS seconds, 'present' AS what, certain
        FROM intervals_presences WHERE sequence = $s AND track = $t
        UNION ALL SELECT first, last, round(last_s - first_s, 1), 'absent', certain
        FROM intervals_absences WHERE sequence = $s AND track = $t""",
    "objects": """
        SELECT category, count(*) AS things, count(*) FILTER (WHERE told) AS handled,
               count(*) FILTER (WHERE NOT told) AS hard_only
        FROM (SELECT category, (SELECT bool_or(certain) FROM intervals_handles h WHERE h.sequence = o.sequence
                                AND h.object = o.object AND h.category_id = o.category_id) AS told
              FROM intervals_objects o WHERE sequence = $s) GROUP BY category""",
}


@pytest.fixture(scope="module")
def graph(sample_benchmark):
    with Graph.open(sample_benchmark.graph_path, read_only=True) as opened:
        yield opened


@contextlib.contextmanager
def open_views(store):
    """DuckDB with a view of each interval table, `intervals_<kind>`."""
    with duckdb.connect() as connection:
        for kind in INTERVALS:
            files = store.path / "intervals" / kind / "*.parquet"
            connection.execute(f"CREATE VIEW intervals_{kind} AS SELECT * FROM read_parquet('{files}')")
        yield connection


@pytest.fixture(scope="module")
def views(sample_benchmark):
    with open_views(sample_benchmark) as connection:
        yield connection


def rows(table):
    return sorted(repr([(name, plain(value)) for name, value in row.items()]) for row in table.to_pylist())


def plain(value):
    return round(value, 6) + 0.0 if isinstance(value, float) else value


def test_every_kept_query_is_compared():
    # `descriptions` is a query over the keyframe layer, which this store lacks.
    kept = {path.stem for path in Path(jrdb_avr.__file__).parent.glob("queries/explore/*.cypher")}
    assert EXPECTED.keys() == kept - BELIEF_QUERIES - {"descriptions"}


def compare(graph, views, name, moments):
    query, compared = named_queries("cypher")[name], 0
    for sequence, frame, track in moments:
        given = {"sequence": sequence, "frame": frame, "track": track}
        answer = graph.query(query.text, query.values({k: given[k] for k in query.types if k in given}), ordered=False)
        values = {"s": sequence, "f": frame, "t": track}
        asked = {k: v for k, v in values.items() if f"${k}" in EXPECTED[name]}
        expected = views.sql(EXPECTED[name], params=asked).to_arrow_table()
        assert answer.column_names == expected.column_names
        assert rows(answer) == rows(expected)
        compared += answer.num_rows
    assert compared


@pytest.mark.parametrize("name", sorted(EXPECTED.keys() - {"things_in_view"}))
def test_kept_queries_agree_with_the_tables(sample_benchmark, graph, views, name):
    tracks = sample_benchmark.interval("interactions", FIRST)["source"].unique().to_pylist()
    compare(graph, views, name, ((FIRST, 60, tracks[0]), (SECOND, 45, 1), (FIRST, 90, tracks[-1])))


def test_things_in_view_agree_with_the_tables(tmp_path):
    """The sample of the tests has no masks of things."""
    store = load_world(tmp_path, random_world(random.Random(37), FIRST))
    frame = store.interval("object_sightings", FIRST)["frame"][0].as_py()
    with Graph.open(store.graph_path, read_only=True) as graph, open_views(store) as views:
        compare(graph, views, "things_in_view", ((FIRST, frame, 0),))


def test_answers_come_in_the_same_order_from_a_shell_of_the_engine(graph):
    for name in EXPECTED:
        query = named_queries("cypher")[name]
        given = {"sequence": FIRST, "frame": 60, "track": 5}
        assert graph.explain(query.text, query.values({k: given[k] for k in query.types if k in given})).ordered, name


@pytest.mark.parametrize("step", [1, 15])
def test_what_goes_on_under_another_certainty_is_no_change_of_group(step):
    # In group 1 to the fifth label, hard at the third; away at the sixth; back at the seventh.
    with Graph.memory() as graph:
        for statement in scene_ddl():
            graph.execute(statement)
        graph.execute("CREATE (:Sequence {sequence: 's', action_step: $step})", {"step": step})
        graph.execute("CREATE (:Person {id: 's/4', sequence: 's', track: 4})")
        graph.execute("CREATE (:SocialGroup {id: 's/1', sequence: 's', cluster: 1})")
        for first, last, certain in ((1, 2, True), (3, 3, False), (4, 5, True), (7, 7, False)):
            graph.execute(
                "MATCH (p:Person), (g:SocialGroup) CREATE (p)-[:MemberOf {sequence: 's', first: $first, last: $last, "
                "certain: $certain}]->(g)",
                {"first": first * step, "last": last * step, "certain": certain},
            )
        found = graph.query(named_queries("cypher")["group_changes"].text, {"sequence": "s"}).to_pylist()
    assert [(row["frame"] // step, row["change"], row["certain"]) for row in found] == [
        (1, "joins", True),
        (5, "leaves", True),
        (7, "joins", False),
        (7, "leaves", False),
    ]


def test_the_store_answers_by_name_and_by_statement(sample_benchmark):
    by_name = Store(sample_benchmark.path).cypher("who_is_where", sequence=FIRST, seconds=4.0)
    assert by_name.num_rows
    assert by_name.equals(sample_benchmark.cypher("who_is_where", sequence=FIRST, frame=60))
    first = sample_benchmark.cypher("timeline", sequence=FIRST, track=5)["first"].to_pylist()
    assert first == sorted(first)


def test_a_sequence_that_is_not_loaded_names_the_nearest(sample_benchmark):
    with pytest.raises(QueryError, match=f"did you mean {FIRST}"):
        sample_benchmark.cypher("objects", sequence=FIRST[:-2])
