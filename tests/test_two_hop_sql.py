"""The candidates of two hops, joined by DuckDB over the interval tables, against those that the generator finds."""

import duckdb
import pytest

from jrdb_avr.engine.candidates import VALUES
from jrdb_avr.engine.descriptions import describe_people
from jrdb_avr.engine.relations import RELATIONS, find_facts
from jrdb_avr.engine.scene import load_scene
from jrdb_avr.engine.search import find_candidates, search_graph
from jrdb_avr.engine.templates import TEMPLATES
from jrdb_avr.schema.rules import Rules

STEPS = """
CREATE TABLE labels AS
    SELECT unnest(['walking together', 'standing together', 'conversation', 'sitting together',
        'going upstairs together', 'moving together', 'looking at robot together', 'looking at sth together',
        'walking toward each other', 'eating together', 'going downstairs together', 'bending together',
        'holding sth together', 'cycling together', 'interaction with door together', 'hugging',
        'looking into sth together', 'shaking hand', 'waving hand together', 'pointing at sth together'
    ]) AS label, 'social' AS kind
    UNION ALL SELECT 'in the same group as', 'group'
    UNION ALL SELECT 'first to the ' || side || ' of (robot view)', 'robot' FROM (VALUES ('left'), ('right')) t(side)
    UNION ALL SELECT sector || ', ' || word, 'place'
        FROM (VALUES ('front'), ('front left'), ('left'), ('back left'), ('back'), ('back right'), ('right'),
            ('front right')) s(sector), (VALUES ('very close'), ('close'), ('moderate')) w(word);
CREATE TABLE times AS SELECT unnest(keyframes) AS t FROM sequence;
CREATE TABLE people AS
    SELECT t, track, pose, interactions_listed AS social, located AS place, true AS robot,
        EXISTS (FROM memberships m WHERE m.track = s.track AND t BETWEEN m.first AND m.last) AS "group"
    FROM sightings s JOIN times ON frame = t;
CREATE TABLE told AS UNPIVOT people ON social, place, robot, "group" INTO NAME kind VALUE tells;
CREATE TABLE facts AS
    SELECT t, source, target, label, bool_or(certain) AS sure FROM (
        SELECT t, source, target, label, certain FROM interactions JOIN times ON t BETWEEN first AND last
        UNION ALL SELECT t, source, target, label, certain FROM beside JOIN times ON t BETWEEN first AND last
        UNION ALL SELECT t, a.track, b.track, 'in the same group as', a.certain AND b.certain
            FROM memberships a JOIN memberships b ON a.cluster = b.cluster AND a.track <> b.track
            JOIN times ON t BETWEEN a.first AND a.last AND t BETWEEN b.first AND b.last)
    GROUP BY ALL;
CREATE TABLE steps AS
    SELECT a.t, a.track AS source, l.label AS label, count_if(sure IS NOT NULL OR NOT (a.tells AND b.tells)) AS could,
        count_if(sure) AS certain, any_value(b.track) FILTER (sure) AS target
    FROM told a JOIN told b ON a.t = b.t AND a.kind = b.kind AND a.track <> b.track JOIN labels l ON l.kind = a.kind
    LEFT JOIN facts f ON f.t = a.t AND f.source = a.track AND f.target = b.track AND f.label = l.label
    GROUP BY a.t, a.track, l.label
    HAVING could = 1 AND certain = 1;
"""

TWO_HOPS = """
SELECT n.t, n.track, one.label, one.target, two.label, two.target, p.pose
FROM named n JOIN steps one ON one.t = n.t AND one.source = n.track
JOIN steps two ON two.t = n.t AND two.source = one.target AND two.target <> n.track
JOIN people p ON p.t = n.t AND p.track = two.target AND p.pose IS NOT NULL
"""


TABLES = ("sequence", "sightings", "memberships", "interactions", "beside")


@pytest.mark.parametrize("number", range(3))
def test_duckdb_finds_the_same_two_hops_as_the_generator(sample_benchmark, number):
    store, rules = sample_benchmark, Rules()
    sequence = sorted(path.stem for path in (store.path / "intervals" / "sightings").glob("*.parquet"))[number]
    scene = load_scene(store, sequence)
    facts = find_facts(scene)
    descriptions = describe_people(scene, facts, rules)
    template = next(template for template in TEMPLATES if template.name == "two_hop")
    with search_graph(scene, facts, descriptions, rules) as graph:
        found = find_candidates(scene, facts, descriptions, graph, template, rules)

    def moments(numbers):
        return list(zip(scene.frames(numbers).tolist(), tracks(numbers), strict=True))

    def tracks(numbers):
        return scene.tracks[scene.persons(numbers)].tolist()

    first, second = ([RELATIONS[code] for code in found.relations[name]] for name in ("r1", "r2"))
    people = [tracks(found.people[node]) for node in "bc"]
    answers = [VALUES[code] for code in found.answer]
    starts = moments(found.people["a"])
    engine = [
        (*start, *rest) for start, *rest in zip(starts, first, people[0], second, people[1], answers, strict=True)
    ]
    with duckdb.connect(config={"threads": 1}) as connection:
        for table in TABLES:
            connection.read_parquet(str(store.interval_path(table, sequence))).create(table)
        named = moments(descriptions.moment[descriptions.general])
        connection.execute("CREATE TABLE named(t INTEGER, track INTEGER)")
        connection.executemany("INSERT INTO named VALUES (?, ?)", named)
        connection.execute(STEPS)
        joined = connection.execute(TWO_HOPS).fetchall()
    assert len(joined) > 100
    assert sorted(joined) == sorted(engine)
