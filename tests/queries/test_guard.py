"""Ad-hoc Cypher and SQL read the store and nothing else, whatever is asked."""

import json
import math
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from environment import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st
from processes import run_program, run_statement_here

from jrdb_avr.queries.graph import guard
from jrdb_avr.queries.graph.guard import check_cypher, query_graph
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.manifest import Manifest, SequenceEntry
from jrdb_avr.queries.named import find_query, named_queries, parse_value
from jrdb_avr.queries.sql import JOINED, open_tables, query_tables, views
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, LockedError, QueryError, StoreError
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, scene_ddl
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import QUESTIONS, RUNS

pytestmark = pytest.mark.usefixtures("own_processes")

SECRET = "a line that must not be read"


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("store") / "S"
    with build_graph(folder / "graph.kuzu") as graph:
        for statement in scene_ddl():
            graph.execute(statement)
        people = range(1, 6)
        graph.copy(
            "Person",
            pa.table(
                {
                    "id": [f"s/{n}" for n in people],
                    "sequence": ["s"] * 5,
                    "track": people,
                    "gender": ["Female", "Male", None, "Female", None],
                    "age": ["Adult"] * 5,
                    "ethnicity": [None] * 5,
                    "first_frame": [0] * 5,
                    "last_frame": [30] * 5,
                }
            ),
        )
    place = Store(folder)
    rows = [
        {"question_id": f"{n:016x}", "sequence": "s", "family": "f", "template": "t", "question": f"Which {n}?"}
        | {"choices": [], "answer_mode": "frame"}
        for n in range(3)
    ]
    place.write_questions("questions", pa.Table.from_pylist(rows, schema=QUESTIONS["questions"]), {})
    place.write_manifest(Manifest(None, LoadRules(), "", {"s": SequenceEntry((), {})}, {}))
    return place


# -- Cypher ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def without_process(monkeypatch):
    """Statements run in the tests' own process, for tests of statements that do it no harm: a child is dearer."""

    monkeypatch.setattr(guard, "run_child", run_statement_here)


def test_reading_works(store):
    """In processes, as users' statements run."""
    found = store.cypher("MATCH (p:Person) WHERE p.track >= $least RETURN p.track AS t ORDER BY t DESC", least=4)
    assert found["t"].to_pylist() == [5, 4]
    assert store.cypher("UNWIND [3, 1, 2] AS x RETURN x;")["x"].to_pylist() == [1, 2, 3]


def test_rows_without_an_order_are_sorted(store, without_process):
    # Without ORDER BY the rows are sorted, nulls last.
    found = store.cypher("MATCH (p:Person) RETURN p.gender AS g, p.track AS t")
    assert found.to_pylist()[0] == {"g": "Female", "t": 1}
    assert found["t"].to_pylist() == [1, 4, 2, 3, 5]


HOSTILE = [
    "CREATE (p:Person {id: 'x'})",
    "MATCH (p:Person) SET p.age = 'x'",
    "MATCH (p:Person) WHERE p.track = 1SET p.age = 'x'",
    "MATCH (p:Person) DETACH DELETE p",
    "MATCH (p:Person) REMOVE p.age",
    "MERGE (p:Person {id: 'x'})",
    "create node table X(id INT64 PRIMARY KEY)",
    "DROP TABLE Person",
    "ALTER TABLE Person ADD x INT64",
    "COPY Person FROM '{secret}'",
    "COPY (MATCH (p:Person) RETURN p.id) TO '{target}'",
    "LOAD FROM '{secret}' RETURN *",
    "LOAD FROM '{secret}' (header=false, file_format='csv') RETURN *",
    "load/**/from '{secret}' return *",
    "MATCH (p:Person) LOAD FROM '{secret}' RETURN *",
    "EXPORT DATABASE '{target}'",
    "IMPORT DATABASE '{target}'",
    "ATTACH '{target}' AS x (dbtype kuzu)",
    "USE x",
    "INSTALL httpfs",
    "LOAD EXTENSION '{target}'",
    "CALL show_tables() RETURN *",
    "CALL timeout=0",
    "CALL show_functions() RETURN *",
    "CHECKPOINT",
    "BEGIN TRANSACTION",
    "COMMIT",
    "EXPLAIN MATCH (p:Person) RETURN p",
    "PROFILE MATCH (p:Person) RETURN p",
    "CREATE MACRO f(x) AS x",
    "COMMENT ON TABLE Person IS 'x'",
    "RETURN 1; COPY (RETURN 1) TO '{target}'",
    "RETURN '\\'; COPY (RETURN 1) TO \\'{target}\\'//'",
    "RETURN 'a' //\rCOPY (RETURN 1) TO '{target}'",
    "RETURN 'a",
    "RETURN /* a",
    "MATCH (p:Person) WHERE all(x IN [1] WHERE x > 0) RETURN p",
    "MATCH (p:Person) WHERE any(x IN [1] WHERE x > 0) RETURN p",
]
"""Statements with a word of a refused clause."""

PAST_THE_WORDS = (
    "Lo\u0410D FROM '{secret}' RETURN *",
    "",
    ";",
    "   ",
    "nonsense",
    "MATCH (p:Nobody) RETURN p",
    "RETURN $missing",
)
"""Hostile statements without such a word: the engine refuses them."""


@pytest.fixture
def surroundings(store, tmp_path):
    """A secret beside, a place to write to, and a check afterwards that nothing has changed."""
    secret, target = tmp_path / "secret.csv", tmp_path / "target.csv"
    secret.write_text(f"id\n{SECRET}\n")
    before = {place: place.read_bytes() for place in store.path.rglob("*") if place.is_file()}
    yield {"secret": str(secret), "target": str(target)}
    assert sorted(tmp_path.iterdir()) == [secret]
    assert {place: place.read_bytes() for place in store.path.rglob("*") if place.is_file()} == before


def test_hostile_cypher_is_refused_in_one_line(store, surroundings, without_process):
    for text in (*HOSTILE, *PAST_THE_WORDS):
        cypher = text.replace("{secret}", surroundings["secret"]).replace("{target}", surroundings["target"])
        with pytest.raises(QueryError) as error:
            store.cypher(cypher)
        assert "\n" not in str(error.value)
        assert SECRET not in str(error.value)


@pytest.mark.parametrize(
    "text",
    [
        *HOSTILE,
        "RETURN 1; RETURN 2",
        "RETURN 'a\\b'",
        "RETURN 1 //\rRETURN 2",
        "MATCH (p:Person)/**/SET/**/p.age = 'x'",
    ],
)
def test_the_words_are_the_first_door(text):
    """They refuse by themselves what the plan or the read-only database would refuse as well."""
    with pytest.raises(QueryError):
        check_cypher(text)


@pytest.mark.parametrize(
    "text",
    [
        "RETURN 'COPY this to SET that' AS text",
        'RETURN "it is /* no comment" AS text',
        "MATCH (p:Person) // DELETE nobody\nRETURN p.id /* CALL nobody */;",
        "MATCH (p:Person) WHERE p.age = $set RETURN p.track AS `LOAD FROM`, p.track AS asset, p.track AS set_1",
    ],
)
def test_words_inside_texts_comments_and_names_are_no_clauses(text):
    check_cypher(text)


def test_the_plan_is_the_second_door(store, surroundings):
    # Past the words: what reads or writes files still stops at the plan, what writes at the read-only database.
    for text in (*HOSTILE, *PAST_THE_WORDS):
        if re.match(r"(?i)(.*LOAD.*FROM|COPY|CALL|CREATE|MERGE|DROP|ALTER|MATCH.*(SET|DELETE))", text):
            cypher = text.replace("{secret}", surroundings["secret"]).replace("{target}", surroundings["target"])
            with pytest.raises((QueryError, StoreError)):
                guard._read(str(store.graph_path), cypher, {}, 5.0)


VOCABULARY = """MATCH (p:Person) RETURN p.id WHERE LOAD FROM 'secret' COPY TO CREATE SET DELETE UNION WITH AS CALL
    EXISTS COUNT ORDER BY LIMIT ATTACH $x x 1 , ( ) { } [ ] * /* */ // ' ` \\ ; . = : " """
WORDS = st.sampled_from([*re.findall(r"\S+", VOCABULARY), "\n"])


@given(st.lists(st.one_of(WORDS, st.text(max_size=3)), max_size=14).map(" ".join))
@example("MATCH (p:Person) RETURN `LOAD FROM` ")
@settings(max_examples=examples(40), deadline=None)
def test_what_passes_the_words_has_no_writing_clause(text):
    try:
        check_cypher(text)
    except QueryError as error:
        assert "\n" not in str(error)
        return
    # An independent reading: take the quoted parts out character by character and look at the bare words.
    bare, at = [], 0
    while at < len(text):
        for opening, closing in (("'", "'"), ('"', '"'), ("`", "`"), ("//", "\n"), ("/*", "*/")):
            if text.startswith(opening, at):
                end = text.find(closing, at + len(opening))
                at = len(text) if end < 0 else end + len(closing)
                bare.append(" ")
                break
        else:
            bare.append(text[at])
            at += 1
    words = re.findall(r"[A-Z_]+", "".join(bare).upper())
    assert not {"LOAD", "COPY", "CREATE", "SET", "DELETE", "CALL", "ATTACH"} & set(words)


@pytest.fixture(scope="module")
def graph_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz") / "graph.kuzu"
    with build_graph(path) as graph:
        graph.execute("CREATE NODE TABLE Person(id STRING PRIMARY KEY)")
    return path


@given(text=st.lists(WORDS, max_size=12).map(" ".join))
@settings(max_examples=examples(20), deadline=None)
def test_fuzzed_statements_change_nothing(graph_file, text):
    before = graph_file.read_bytes()
    try:
        check_cypher(text)
        guard._read(str(graph_file), text, {}, 2.0)
    except AvrError as error:
        assert SECRET not in str(error)
    assert graph_file.read_bytes() == before
    assert sorted(place.name for place in graph_file.parent.iterdir()) == [
        "graph.kuzu",
        "graph.kuzu.json",
        "graph.kuzu.lock",
    ]


@pytest.mark.parametrize(
    "value", [np.int64(3), np.float64(0.5), np.str_("x"), np.bool_(True), float("inf"), [np.int8(1)]]
)
def test_cells_of_data_frames_are_parameters(store, value, without_process):
    assert math.isnan(store.cypher("RETURN $x AS x", x=float("nan"))["x"][0].as_py())
    plain = [1] if isinstance(value, list) else value
    assert store.cypher("RETURN $x AS x", x=value)["x"].to_pylist() == [plain]
    if not isinstance(value, list):
        assert store.sql("SELECT $x AS x", x=value)["x"].to_pylist() == [plain]


@pytest.mark.parametrize("value", [object(), {1}, b"x", "\ud800", ["\ud800"], pa.table({"a": [1]}), 1 << 70])
def test_what_cannot_be_a_parameter_is_one_line(store, value):
    with pytest.raises(QueryError) as error:
        store.cypher("RETURN $x AS x", x=value)
    assert "\n" not in str(error.value)
    assert "crashed" not in str(error.value)


def test_a_map_comes_as_it_is_or_an_error_says_what_to_return(store, without_process):
    # Some versions of pyarrow take back the keys' type as the engine gives it.
    try:
        assert store.cypher("RETURN map(['k'], [1]) AS m").to_pylist() == [{"m": [("k", 1)]}]
    except QueryError as error:
        assert "map_keys(...)" in str(error)
    found = store.cypher("WITH map(['k'], [1]) AS m RETURN map_keys(m) AS k, map_values(m) AS v")
    assert found.to_pylist() == [{"k": ["k"], "v": [1]}]


def test_a_statement_that_runs_on_is_stopped(store):
    # The engine does not look at its clock inside range(); the process is ended, by the clock or, where the list grows
    # fast, by its memory.
    with pytest.raises(QueryError, match=r"stopped (after|at 2 GB)"):
        query_graph(store.graph_path, "UNWIND range(1, 1000000000) AS i RETURN count(*) AS n", timeout_s=-9.0)


def test_too_much_memory_is_an_error(store):
    with pytest.raises(QueryError, match="memory"):
        store.cypher("RETURN size(repeat('a', 1000000000)) AS n")


def test_no_graph_and_a_busy_graph(store, tmp_path):
    with pytest.raises(StoreError, match="does not exist"):
        query_graph(tmp_path / "graph.kuzu", "RETURN 1 AS x")
    with Graph.open(store.graph_path), pytest.raises(LockedError, match="in use by process"):
        store.cypher("RETURN 1 AS x")


# -- SQL ------------------------------------------------------------------------------------------------------------


def test_every_table_is_a_view_even_before_it_is_written(store):
    shown = query_tables(store.path, "SHOW TABLES")["name"].to_pylist()
    assert shown == sorted([*(name for name, _, _ in views(store.path)), *JOINED])
    assert {"annotations_boxes_2d", "intervals_actions", "questions", "scores", "predictions", "steps"} <= set(shown)
    # All rows of all of them in one statement: a connection is dear.
    rows = store.sql(
        "SELECT " + ", ".join(f"(SELECT list(t) FROM {name} t) AS {name}" for name, *_ in views(store.path))
    )
    for name, schema, files in views(store.path):
        assert [field.name for field in rows.schema.field(name).type.value_type] == schema.names
        assert len(rows[name][0].as_py() or ()) == (3 if files else 0)


def test_views_hold_the_files(store):
    assert store.sql("SELECT count(*) AS n FROM questions WHERE answer_mode = $mode", mode="frame").to_pylist() == [
        {"n": 3}
    ]
    for name in ("one", "two"):
        rows = [{"run_id": name, "question_id": "q", "answer_score": 1, "evidence_score": 0, "combined_score": 0}]
        rows[0]["invalid"] = False
        store.write_run(name, "scores", pa.Table.from_pylist(rows, schema=RUNS["scores"]))
    assert store.sql("SELECT run_id FROM scores ORDER BY ALL")["run_id"].to_pylist() == ["one", "two"]


def test_no_progress_bar_is_written_among_the_output(store):
    code = (
        "import sys; from jrdb_avr.queries.sql import query_tables; from pathlib import Path\n"
        "setting = \"SELECT current_setting('enable_progress_bar') AS shown\"\n"
        "assert query_tables(Path(sys.argv[1]), setting)['shown'].to_pylist() == [False]"
    )
    # DuckDB shows it in programs that are no file.
    assert run_program(code, str(store.path)).returncode == 0


def test_hostile_sql_is_refused_in_one_line(store, surroundings):
    secret, target = surroundings["secret"], surroundings["target"]
    inside = str(store.question_path("questions"))
    with open_tables(store.path) as select:
        for sql in (
            f"SELECT * FROM read_csv('{secret}')",
            f"SELECT * FROM '{secret}'",
            f"SELECT * FROM read_text('{secret}')",
            f"SELECT * FROM read_blob('{secret}')",
            f"SELECT * FROM sniff_csv('{secret}')",
            "SELECT * FROM read_csv('/etc/passwd')",
            "SELECT * FROM glob('/etc/*')",
            "SELECT * FROM surroundings",
            f"COPY questions TO '{target}'",
            f"COPY questions TO '{inside}' (FORMAT parquet)",
            f"COPY (SELECT 1) TO '{target}'",
            f"EXPORT DATABASE '{target}'",
            f"ATTACH '{target}' AS x",
            "SELECT '\ud800'",
            "INSTALL httpfs",
            "LOAD httpfs",
            "SET enable_external_access = true",
            "RESET lock_configuration",
            "PRAGMA enable_profiling",
            "CREATE TABLE x AS SELECT 1",
            "DROP VIEW questions",
            "DELETE FROM questions",
            "INSERT INTO questions SELECT * FROM questions",
            "WITH x AS (DELETE FROM questions RETURNING *) SELECT * FROM x",
            "SELECT 1; SELECT 2",
            f"SELECT 1; COPY questions TO '{target}'",
            f"EXPLAIN ANALYZE COPY questions TO '{target}'",
            f"SELECT * FROM query('COPY questions TO ''{target}''')",
            f"SELECT * FROM read_csv('{target}/../secret.csv')",
            "SELECT * FROM read_parquet('http://127.0.0.1:9/x.parquet')",
            "CALL pragma_version()",
            "VACUUM",
            "",
            "nonsense",
            "SELECT * FROM nowhere",
            "SELECT nothing FROM questions",
            "SELECT $missing",
        ):
            with pytest.raises(QueryError) as error:
                select(sql)
            assert "\n" not in str(error.value)
            assert SECRET not in str(error.value)


def test_sql_has_two_gigabytes(store):
    assert store.sql("SELECT current_setting('memory_limit') AS bytes")["bytes"].to_pylist() == ["1.8 GiB"]


def test_cypher_is_stopped_at_its_memory(store, monkeypatch):
    less = "from jrdb_avr.queries.graph import guard\nguard.MEMORY_BYTES = 400 << 20\nguard.serve()"
    monkeypatch.setattr(guard, "run_child", lambda request, timeout_s: run_program(less, stdin=request))
    with pytest.raises(QueryError, match="GB of memory"):
        store.cypher("UNWIND range(1, 400000000) AS x RETURN x")


def test_sql_is_stopped_in_time(store):
    endless = "SELECT count(*) FROM range(10000000) a, range(10000000) b WHERE a.range % 7 = b.range % 5"
    with pytest.raises(QueryError, match="stopped after"):
        query_tables(store.path, endless, timeout_s=0.3)


def test_a_broken_file_spoils_its_own_view_only(store, tmp_path):
    place = Store(tmp_path / "S")
    place.write_questions("questions", pa.table({n: [] for n in QUESTIONS["questions"].names}), {})
    path = place.run_path("r") / "predictions.parquet"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"no parquet")
    assert place.sql("SELECT count(*) AS n FROM questions").to_pylist() == [{"n": 0}]
    with pytest.raises(QueryError, match="cannot read the files of predictions"):
        place.sql("SELECT * FROM predictions")
    poses = place.path / "annotations" / "poses" / "a.parquet"
    poses.parent.mkdir(parents=True)
    poses.write_bytes(b"no parquet")
    with pytest.raises(QueryError, match="cannot read the files of annotations_poses"):
        place.sql("SELECT * FROM sightings_keypoints")
    pq.write_table(pa.table({"x": [1]}), poses)
    with pytest.raises(QueryError, match=r"cannot make sightings_keypoints: .*sequence"):
        place.sql("SELECT * FROM sightings_keypoints")
    assert place.sql("SELECT count(*) AS n FROM questions").to_pylist() == [{"n": 0}]


def test_sql_needs_a_store(tmp_path):
    with pytest.raises(StoreError, match="jrdb-avr load"):
        Store(tmp_path / "none").sql("SELECT 1")


# -- named queries --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("language", ["cypher", "sql"])
def test_every_named_query_runs_on_its_defaults(store, language, without_process):
    known = named_queries(language)
    assert known
    examples = {"sequence": "s", "track": 1, "frame": 15}
    for name, query in known.items():
        assert query.answers.endswith("."), f"{name}: the first comment line says what it answers"
        if any(f":{table}" in query.text for table in ("Episode", *LAYER_NODES, *LAYER_RELS)):
            # This graph has no beliefs and no keyframe layer. Other tests run these statements by their names.
            continue
        assert sorted(query.types) == parameters(query.text) or language == "sql"
        given = {key: examples[key] for key in query.types if key not in query.defaults}
        table = getattr(store, language)(name, **given)
        assert isinstance(table, pa.Table)
        assert len(set(table.column_names)) == table.num_columns


@given(st.one_of(st.integers(), st.booleans(), st.lists(st.integers(), max_size=3), st.none()))
@example("15")
def test_values_are_json_or_text(value):
    assert parse_value(json.dumps(value)) == value
    assert [parse_value(text) for text in ("gates-ai-lab-2019-02-08_0", "")] == ["gates-ai-lab-2019-02-08_0", ""]


def test_named_queries_are_found_by_name():
    text, params = find_query("cypher", "who_is_where", {"sequence": "s", "frame": 30})
    assert "SeenIn" in text
    assert params == {"sequence": "s", "frame": 30}
    assert find_query("cypher", "who_is_where", {"sequence": "s", "seconds": 2.0})[1] == params
    assert find_query("cypher", "who_is_where", {"sequence": 7, "seconds": 2})[1] == {"sequence": "7", "frame": 30}
    assert find_query("cypher", "busiest_frames", {})[1] == {"count": 20}
    assert find_query("sql", "SELECT 1", {}) == ("SELECT 1", {})


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("who_is_when", {}, "did you mean who_is_where"),
        ("zzz", {}, "--list shows all"),
        ("who_is_where", {}, "needs --param sequence=TEXT --param frame=INTEGER; it takes sequence"),
        ("who_is_where", {"sequence": "s", "fram": 1}, "no parameter 'fram'; it takes sequence"),
        ("who_is_where", {"sequence": "s", "frame": "x"}, "frame is integer, not 'x': give frame=INTEGER"),
        ("who_is_where", {"sequence": "s", "frame": 1.5}, "frame is integer"),
        ("who_is_where", {"sequence": "s", "frame": True}, "frame is integer"),
        ("who_is_where", {"sequence": "s", "seconds": "soon"}, "seconds is number"),
        ("who_is_where", {"sequence": "s", "seconds": float("inf")}, "seconds is number"),
        ("who_is_where", {"sequence": "s", "seconds": float("nan")}, "seconds is number"),
        ("who_is_where", {"sequence": "s", "seconds": 1, "frame": 15}, "no parameter 'seconds'"),
        ("who_is_where", {"sequence": [1], "frame": 1}, "sequence is text"),
        ("sequences", {"frame": 1}, "it takes none"),
    ],
)
def test_wrong_names_and_parameters_say_what_to_give(name, given, words):
    with pytest.raises(QueryError, match=words) as error:
        find_query("cypher", name, given)
    assert "\n" not in str(error.value)
