"""The engine's traps: what the pinned version answers wrongly, and that the handle refuses it or answers rightly.

Run on another engine or version (docs/graph.md, "Another engine"), the tests `test_trap_...` judge it trap by trap: one
that fails at MENDED is good news. The others hold whatever the engine, and must pass before it may be used.

The order of rows when several threads read is not here, as chance decides; `Graph.query` asks for an ORDER BY.
"""

import itertools
import random
import resource
import signal

import duckdb
import pyarrow as pa
import pytest
from processes import run_program

from jrdb_avr.queries.graph.database import engine
from jrdb_avr.queries.graph.file import ENGINE
from jrdb_avr.queries.graph.guard import check_cypher
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.schema.errors import QueryError

MENDED = "the engine answers rightly now: see whether its guard may go"


@pytest.fixture
def path(tmp_path):
    place = tmp_path / "graph.kuzu"
    with build_graph(place) as graph:
        graph.execute("CREATE NODE TABLE N(id INT64 PRIMARY KEY, v INT64)")
        graph.copy("N", pa.table({"id": range(5000), "v": [i * i for i in range(5000)]}))
    return place


def raw(graph, cypher, **params):
    """Rows of a statement as the engine answers it, past the handle."""
    return graph._connection.execute(cypher, params).get_all()


def fill(graph, edges, nodes=(1, 2, 3, 4)):
    """Nodes N, and edges R from, to, k."""
    graph.execute("CREATE NODE TABLE N(id INT64 PRIMARY KEY, s STRING)")
    graph.execute("CREATE REL TABLE R(FROM N TO N, k INT64)")
    graph.copy("N", pa.table({"id": pa.array(nodes, pa.int64()), "s": ["x"] * len(nodes)}))
    graph.copy(
        "R", pa.table([pa.array([edge[i] for edge in edges], pa.int64()) for i in range(3)], ["from", "to", "k"])
    )


def crashes(program, **limits):
    """Whether the engine ends a process that runs `program`, which has its module as E and a connection as c."""
    begin = f"import {ENGINE} as E\nc = E.Connection(E.Database(':memory:', max_db_size=1 << 30))\n"
    done = run_program(begin + program, limits={resource.RLIMIT_CORE: 0, **limits})
    return done.returncode == -signal.SIGSEGV


# -- patterns -------------------------------------------------------------------------------------------------------

DIAMOND = (
    "MATCH (a:N)-[r1:R]->(b:N)-[r2:R]->(d:N), (a)-[r3:R]->(c:N)-[r4:R]->(d) WHERE b.id < c.id RETURN count(*) AS n",
    "MATCH (a:N)-[:R]->(b:N)-[:R]->(d:N) WITH a, b, d MATCH (a)-[:R]->(c:N) WHERE b.id < c.id "
    "WITH c, d MATCH (c)-[:R]->(e:N) WHERE e.id = d.id RETURN count(*) AS n",
)
TRIANGLE = (
    "MATCH (a:N)-[r1:R]->(b:N)-[r2:R]->(c:N), (a)-[r3:R]->(c) RETURN count(*) AS n",
    "MATCH (a:N)-[:R]->(b:N)-[:R]->(c:N) WITH a, c MATCH (a)-[:R]->(d:N) WHERE d.id = c.id RETURN count(*) AS n",
)


@pytest.mark.parametrize(
    ("pairs", "statements", "truth"),
    [(((1, 2), (2, 4), (1, 3), (3, 4)), DIAMOND, 2**4), (((1, 2), (2, 3), (1, 3)), TRIANGLE, 2**3)],
)
def test_trap_a_loop_loses_parallel_edges(memory, pairs, statements, truth):
    fill(memory, [(*pair, k) for pair in pairs for k in (0, 1)])
    loop, split = statements
    assert "INTERSECT" in memory.explain(loop).operators
    assert raw(memory, loop)[0][0] < truth, MENDED
    with pytest.raises(QueryError, match="lose rows"):
        memory.query(loop)
    with pytest.raises(QueryError, match="lose rows"):
        memory.execute(loop.replace("RETURN count(*) AS n", "CREATE (a)-[:R {k: 9}]->(c)"))
    assert memory.query(split)["n"].to_pylist() == [truth]


TWO_HOPS = {
    "(a:N)-[r:R]->(b:N)-[s:R]->(c:N)": lambda r, s: r[1] == s[0],
    "(a:N)-[r:R]->(b:N)<-[s:R]-(c:N)": lambda r, s: r[1] == s[1],
    "(a:N)<-[r:R]-(b:N)-[s:R]->(c:N)": lambda r, s: r[0] == s[0],
}
CONDITIONS = {
    "true": lambda r, s: True,
    "r.k = s.k": lambda r, s: r[2] == s[2],
    "r.k < s.k": lambda r, s: r[2] < s[2],
    "r.k = 1 AND s.k = 0": lambda r, s: (r[2], s[2]) == (1, 0),
}


def test_two_hops_are_counted_right():
    """Small multigraphs by chance, and every two-hop pattern with and without a condition, against brute force."""
    rng = random.Random(18)
    wrong, total = [], 0
    for _ in range(12):
        nodes = range(1, rng.choice((4, 6, 10)))
        edges = [(rng.choice(nodes), rng.choice(nodes), rng.randrange(3)) for _ in range(rng.randrange(1, 25))]
        with Graph.memory() as graph:
            fill(graph, edges, nodes)
            for (pattern, meets), (text, holds) in itertools.product(TWO_HOPS.items(), CONDITIONS.items()):
                for first in (nodes, [1]):
                    ids = f"a.id <= {first[-1]} AND {text}"
                    start = pattern.startswith("(a:N)<-")
                    truth = sum(
                        meets(r, s) and holds(r, s) and r[start] in first for r, s in itertools.product(edges, repeat=2)
                    )
                    found = graph.query(f"MATCH {pattern} WHERE {ids} RETURN count(*) AS n")["n"][0].as_py()
                    total += 1
                    if found != truth:
                        wrong.append((pattern, ids, found, truth))
    assert not wrong, f"{len(wrong)} of {total} are wrong, the first: {wrong[0]}"


# -- NULL ------------------------------------------------------------------------------------------------------------

NULLS = [(i, i if i % 3 else None, i if i % 4 else None) for i in range(12)]
JOINS = {
    "MATCH (a:A), (b:A) WHERE {} a.v = b.w RETURN count(*) AS n": sum,
    "MATCH (a:A) WITH a.v AS v MATCH (b:A) WHERE {} b.w = v RETURN count(*) AS n": sum,
    "MATCH (a:A) OPTIONAL MATCH (b:A) WHERE {} a.v = b.w RETURN count(b.id) AS n": sum,
    "MATCH (a:A) WHERE EXISTS {{ MATCH (b:A) WHERE {} a.v = b.w }} RETURN count(*) AS n": lambda found: sum(
        map(bool, found)
    ),
}


@pytest.fixture
def nulls(memory):
    memory.execute("CREATE NODE TABLE A(id INT64 PRIMARY KEY, v INT64, w INT64)")
    memory.copy("A", pa.table(dict(zip(("id", "v", "w"), map(list, zip(*NULLS, strict=True)), strict=True))))
    return memory


@pytest.mark.parametrize("join", JOINS)
def test_trap_joins_by_values_lose_rows_where_there_is_null(nulls, join):
    truth = JOINS[join]([sum(v is not None and v == w for _, _, w in NULLS) for _, v, _ in NULLS])
    assert raw(nulls, join.format(""))[0][0] != truth, MENDED
    more = "b.w IS NOT NULL AND a.v IS NOT NULL AND" if "EXISTS" in join else "b.w IS NOT NULL AND"
    assert nulls.query(join.format(more))["n"].to_pylist() == [truth]


def test_trap_a_missing_parameter_is_null(memory):
    fill(memory, [])
    assert raw(memory, "RETURN $number AS n") == [[None]], MENDED
    with pytest.raises(QueryError, match=r"give a value for \$number"):
        memory.query("RETURN $number AS n")


# -- CASE and aggregates ---------------------------------------------------------------------------------------------

FLAGS = [(i, i % 10 != 0, i % 3 == 0, "ab"[i % 2]) for i in range(1000)]


@pytest.fixture
def flags(memory):
    memory.execute("CREATE NODE TABLE F(id INT64 PRIMARY KEY, flag BOOLEAN, g BOOLEAN, s STRING)")
    memory.copy("F", pa.table(dict(zip(("id", "flag", "g", "s"), map(list, zip(*FLAGS, strict=True)), strict=True))))
    return memory


SUM = "MATCH (f:F) RETURN sum(CASE WHEN {} THEN 1 ELSE 0 END) AS n"


@pytest.mark.parametrize(
    "cypher",
    [
        SUM.format("f.flag"),
        SUM.format("(f.flag)"),
        SUM.format("(f).flag"),
        SUM.format("f.`flag`"),
        SUM.format("CAST(f.flag AS BOOL)"),
        SUM.format("cast(f.flag, 'BOOL')"),
        SUM.format("f.id < 0 THEN 1 WHEN f.flag"),
        SUM.format("CASE WHEN f.flag = true THEN true ELSE false END"),
        "MATCH (f:F) WITH f.flag AS g RETURN sum(CASE WHEN g THEN 1 ELSE 0 END) AS n",
        "MATCH (f:F) WITH f.flag AS g RETURN sum(CASE WHEN `g` THEN 1 ELSE 0 END) AS n",
        "MATCH (f:F) WITH f.id % 10 > 0 AS g RETURN sum(CASE WHEN g THEN 1 ELSE 0 END) AS n",
    ],
)
def test_trap_case_on_a_bare_boolean(flags, cypher):
    assert raw(flags, cypher)[0][0] != 900, MENDED
    with pytest.raises(QueryError, match="bare boolean"):
        flags.query(cypher)


def test_case_on_a_bare_boolean_is_refused_in_what_writes_and_in_structs(flags):
    with pytest.raises(QueryError, match="bare boolean"):
        flags.execute("MATCH (f:F) SET f.flag = CASE WHEN f.flag THEN false ELSE true END")
    with pytest.raises(QueryError, match="bare boolean"):
        flags.query("MATCH (f:F) WITH {b: f.flag} AS x RETURN sum(CASE WHEN x.b THEN 1 ELSE 0 END) AS n")
    with pytest.raises(QueryError, match="bare boolean"):
        flags.query(SUM.format("( ( f.flag ) )"))


@pytest.mark.parametrize(
    ("case", "truth"),
    [
        ("CASE WHEN f.flag = true THEN 1 ELSE 0 END", 900),
        ("CASE WHEN NOT f.flag THEN 0 ELSE 1 END", 900),
        ("CASE WHEN NOT f.flag = false THEN 1 ELSE 0 END", 900),
        ("CASE WHEN f.flag AND f.id >= 0 THEN 1 ELSE 0 END", 900),
        ("CASE WHEN f.flag OR f.g THEN 1 ELSE 0 END", sum(flag or g for _, flag, g, _ in FLAGS)),
        ("CASE WHEN f.flag IS NOT NULL AND f.flag THEN 1 ELSE 0 END", 900),
        ("CASE WHEN coalesce(f.flag, false) THEN 1 ELSE 0 END", 900),
        ("CASE WHEN [f.flag][1] THEN 1 ELSE 0 END", 900),
        ("CASE WHEN f.s STARTS WITH 'a' THEN 1 ELSE 0 END", 500),
        ("CASE WHEN true THEN 1 ELSE 0 END", 1000),
        ("CASE WHEN $yes THEN 1 ELSE 0 END", 1000),
        ("CASE WHEN (CASE WHEN f.g = true THEN 1 ELSE 2 END) = 1 THEN 1 ELSE 0 END", 334),
        ("CASE f.flag WHEN true THEN 1 WHEN false THEN 0 END", 900),
        ("CASE true WHEN f.flag THEN 1 ELSE 0 END", 900),
        ("CASE f.s WHEN 'a' THEN 1 ELSE 0 END", 500),
        ("CASE f.flag WHEN f.g THEN 1 ELSE 0 END", sum(flag == g for _, flag, g, _ in FLAGS)),
    ],
)
def test_case_that_the_engine_answers_right_is_not_refused(flags, case, truth):
    params = {"yes": True} if "$yes" in case else {}
    assert flags.query(f"MATCH (f:F) RETURN sum({case}) AS n", params)["n"].to_pylist() == [truth]


AGGREGATES = ("count(*)", "count(n.v)", "sum(n.v)", "avg(n.v)", "min(n.v)", "max(n.s)", "collect(n.v)")
VALUES = [(i, "xyz"[i % 3], [1, 2, None][i % 7 % 3], "ab"[i % 2]) for i in range(40)]


@pytest.fixture
def values(memory):
    memory.execute("CREATE NODE TABLE N(id INT64 PRIMARY KEY, g STRING, v INT64, s STRING)")
    memory.copy("N", pa.table(dict(zip(("id", "g", "v", "s"), map(list, zip(*VALUES, strict=True)), strict=True))))
    return memory


def brute_aggregate(text, rows):
    """What an aggregate is over rows (id, g, v, s)."""
    if text == "count(*)":
        return len(rows)
    column = {"v": 2, "s": 3}[text[-2]]
    found = sorted(row[column] for row in rows if row[column] is not None)
    if "DISTINCT" in text:
        found = sorted(set(found))
    fold = {"count": len, "sum": sum, "avg": lambda x: sum(x) / len(x), "min": min, "max": max, "collect": list}
    return fold[text.partition("(")[0]](found)


def in_order(value):
    return sorted(value) if isinstance(value, list) else value


@pytest.mark.parametrize("second", AGGREGATES)
@pytest.mark.parametrize("form", ["RETURN n.g AS g, {}", "WITH n.g AS g, {} RETURN g, a, b", "RETURN 'k' AS g, {}"])
def test_trap_an_aggregate_after_a_distinct_one(values, form, second):
    wrong = f"MATCH (n:N) {form.format(f'count(DISTINCT n.v) AS a, {second} AS b')} ORDER BY g"
    if not second.startswith("collect"):
        # That one crashes.
        given = raw(values, wrong)
        rows = VALUES if "'k'" in form else [row for row in VALUES if row[1] == "x"]
        assert given[0][2] != brute_aggregate(second, rows), MENDED
    with pytest.raises(QueryError, match="put the DISTINCT last"):
        values.query(wrong)


@pytest.mark.parametrize(
    "projection",
    [
        "n.g AS g, count(DISTINCT CASE WHEN n.s STARTS WITH 'a' THEN n.v END) AS a, count(*) AS b",
        "n.g AS g, count( /* all */ DISTINCT n.v) AS a, COUNT (*) AS b",
        "n.g AS g, {a: count(DISTINCT n.v), b: count(*)} AS a",
        "n.g AS g, count(DISTINCT n.v) + count(*) AS a",
        "n.g AS g, count(*) AS c, count(DISTINCT n.v) AS a, sum(n.v) AS b",
        "n.g AS g, count(DISTINCT n.v) AS a UNION ALL MATCH (n:N) RETURN n.g AS g, count(*) + count(DISTINCT n.v) "
        "+ count(n.v) AS a",
    ],
)
def test_an_aggregate_after_a_distinct_one_is_found_wherever_it_hides(values, projection):
    with pytest.raises(QueryError, match="put the DISTINCT last"):
        values.query(f"MATCH (n:N) RETURN {projection}", ordered=False)


@pytest.mark.parametrize("second", AGGREGATES)
def test_distinct_aggregates_that_the_engine_answers_right_are_not_refused(values, second):
    groups = {group: [row for row in VALUES if row[1] == group] for group in "xyz"}
    one = "count(DISTINCT n.v)"
    for left, right in ((second, one), (one, "count(DISTINCT n.s)")):
        for form in ("RETURN n.g AS g, {}", "WITH n.g AS g, {} RETURN g, a, b"):
            found = values.query(f"MATCH (n:N) {form.format(f'{left} AS a, {right} AS b')} ORDER BY g").to_pylist()
            expected = {g: [brute_aggregate(left, rows), brute_aggregate(right, rows)] for g, rows in groups.items()}
            assert {row["g"]: [in_order(row["a"]), row["b"]] for row in found} == expected
    # Nothing is grouped: either order is right.
    for form in ("RETURN {}", "WITH {} RETURN a, b"):
        found = values.query(f"MATCH (n:N) {form.format(f'{one} AS a, {second} AS b')}").to_pylist()
        assert [(row["a"], in_order(row["b"])) for row in found] == [(2, brute_aggregate(second, VALUES))]
    two = f"MATCH (n:N) WITH n.g AS g, count(DISTINCT n.v) AS a WHERE a > 0 RETURN sum(a) AS a, {'count(*)'} AS b"
    assert values.query(two).to_pylist() == [{"a": 6, "b": 3}]


# -- ORDER BY --------------------------------------------------------------------------------------------------------

MANY = 20_000


@pytest.fixture(scope="module")
def many():
    rng = random.Random(5)
    rows = [(i, f"name {rng.randrange(40)}", rng.randrange(1000), rng.random() < 0.5) for i in range(MANY)]
    rows = [
        (i, name, number, None if rng.random() < 0.3 else f"other {number}", flag) for i, name, number, flag in rows
    ]
    columns = dict(zip(("id", "s", "i", "u", "b"), map(list, zip(*rows, strict=True)), strict=True))
    columns["v"] = [None if rng.random() < 0.3 else number for number in columns["i"]]
    with Graph.memory() as graph:
        graph.execute("CREATE NODE TABLE M(id INT64 PRIMARY KEY, s STRING, i INT64, u STRING, b BOOLEAN, v INT64)")
        graph.copy("M", pa.table(columns))
        yield graph, pa.table(columns)


def duckdb_order(rows, keys, end=""):
    """What DuckDB gives for keys such as "i DESC", where NULL is the largest value."""
    names = [key.split()[0] for key in keys]
    nulls = ", ".join(f"{key} NULLS {'FIRST' if key.endswith('DESC') else 'LAST'}" for key in keys)
    return duckdb.sql(f"SELECT {', '.join(names)} FROM rows ORDER BY {nulls}{end}").fetchall()


@pytest.mark.parametrize(
    ("keys", "end"),
    [
        ("s, i", ""),
        ("s, i", " LIMIT 15000"),
        ("s DESC, b, i DESC", ""),
        ("b, s, i", ""),
        # Wrong as u may be NULL.
        ("i, u", ""),
        ("v DESC", " LIMIT 6000"),
    ],
)
def test_trap_order_by_misplaces_rows(many, keys, end):
    graph, rows = many
    keys = keys.split(", ")
    names = [key.split()[0] for key in keys]
    truth = duckdb_order(rows, keys, end)
    asked = f"MATCH (m:M) RETURN {', '.join(f'm.{name} AS {name}' for name in names)} ORDER BY {', '.join(keys)}{end}"
    assert list(map(tuple, raw(graph, asked))) != truth, MENDED
    if "s" in names[:-1] and names[-1] != "u":
        with pytest.raises(QueryError, match="put the numbers first"):
            graph.query(asked)


@pytest.mark.parametrize("keys", ["i, s", "i DESC, b, s", "s, lower(s)", "s", "i, b"])
def test_an_order_with_numbers_first_is_right(many, keys):
    graph, rows = many
    names = list(dict.fromkeys(key.split()[0] for key in keys.split(", ") if "(" not in key))
    asked = f"MATCH (m:M) RETURN {', '.join(f'm.{name} AS {name}' for name in names)} ORDER BY {keys}"
    truth = duckdb_order(rows, [key for key in keys.split(", ") if "(" not in key])
    assert [tuple(row.values()) for row in graph.query(asked).to_pylist()] == truth


@pytest.mark.parametrize(
    "cypher",
    [
        "MATCH (n:N) WITH n.s AS s, n.id AS i ORDER BY s, i LIMIT 3 RETURN s",
        "MATCH (n:N) RETURN n.s AS s ORDER BY s, n.id",
        "MATCH (n:N) RETURN n.s AS s, n.id AS i ORDER BY s DESC, i // numbers, texts\n SKIP 1 LIMIT 2;",
        "MATCH (n:N) WITH n.s AS s, n.id AS i RETURN * ORDER BY s, i",
        "MATCH (n:N) RETURN n.s AS s, n.id AS i UNION ALL MATCH (n:N) RETURN n.s AS s, n.id AS i ORDER BY s, i",
        "MATCH (n:N) RETURN n.s AS s, n.id = 1 AS b ORDER BY s, b",
        "MATCH (n:N) RETURN n.s AS s, n.id AS skip ORDER BY s, skip LIMIT 3",
        "MATCH (n:N) RETURN n.s AS s, n.id AS i ORDER BY s, s STARTS WITH 'x', i",
        "MATCH (n:N) WHERE n.s = $text RETURN n.s AS s, n.id AS i ORDER BY s, i",
        "MATCH (n:N) RETURN n.s AS `order by`, n.id AS `b,c` ORDER BY `order by`, `b,c`",
    ],
)
def test_a_text_before_a_number_is_refused_however_it_is_written(memory, cypher):
    fill(memory, [])
    with memory.transaction():
        with pytest.raises(QueryError, match="put the numbers first"):
            memory.query(cypher, {"text": "x"} if "$text" in cypher else {}, ordered=False)
        assert memory.query("MATCH (n:N) RETURN count(*) AS n")["n"].to_pylist() == [4]


# -- parameters and COPY ---------------------------------------------------------------------------------------------


def test_trap_small_integers_are_bound_as_bytes(memory):
    with pytest.raises(RuntimeError, match="INT8 range"):
        raw(memory, "RETURN $a * $b AS x", a=100, b=100)
    assert memory.query("RETURN $a * $b AS x ORDER BY x", {"a": 100, "b": 100})["x"].to_pylist() == [10_000]


def test_trap_rows_of_a_parameter_need_a_type(memory):
    for rows in ([], [{"k": 1}, {"j": 2}]):
        with pytest.raises(RuntimeError, match="Binder"):
            raw(memory, "UNWIND $rows AS r RETURN r.k AS k, r.j AS j", rows=rows)
    assert memory.query("UNWIND $rows AS r RETURN r AS r", {"rows": []}, ordered=False).num_rows == 0
    with pytest.raises(QueryError, match="same keys"):
        memory.query("UNWIND $rows AS r RETURN r.k AS k", {"rows": [{"k": 1}, {"j": 2}]})


def test_trap_copy_stops_at_an_empty_chunk(memory):
    rows = pa.table({"id": pa.chunked_array([pa.array(part, pa.int64()) for part in ([1, 2], [], [3, 4])])})
    for name in "AB":
        memory.execute(f"CREATE NODE TABLE {name}(id INT64 PRIMARY KEY)")
    raw(memory, "COPY A FROM $rows", rows=rows)
    assert raw(memory, "MATCH (n:A) RETURN count(*)") == [[2]], MENDED
    memory.copy("B", rows)
    assert memory.query("MATCH (n:B) RETURN count(*) AS n")["n"].to_pylist() == [4]


# -- crashes, and what the language lacks ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["all", "any", "none", "single"])
def test_trap_quantifiers_crash_on_many_rows(name):
    program = """
import pyarrow as pa
c.execute("CREATE NODE TABLE N(id INT64 PRIMARY KEY, l INT64[])")
rows = pa.table({"id": range(5000), "l": [[i % 7, i % 5] for i in range(5000)]})
c.execute("COPY N FROM $rows", {"rows": rows})
c.execute("MATCH (n:N) WHERE NAME(k IN n.l WHERE k > 1) RETURN count(*)")
"""
    assert crashes(program.replace("NAME", name)), MENDED
    with pytest.raises(QueryError, match="crashes the engine"):
        check_cypher(f"MATCH (n:N) WHERE {name}(k IN n.l WHERE k > 1) RETURN count(*)")


def test_trap_the_last_of_several_results_crashes(memory):
    # Freed memory is read: now and then what it held is still there.
    freed = "import gc\nlast = c.execute('RETURN 1; RETURN 2')[-1]\ngc.collect()\nlast.get_all()"
    assert any(crashes(freed) for _ in range(4)), MENDED
    with pytest.raises(QueryError, match="one statement"):
        memory.query("RETURN 1 AS a; RETURN 2 AS b")


# -- statements of strangers ----------------------------------------------------------------------------------------


def test_trap_explain_runs_the_second_statement(memory):
    fill(memory, [])
    both = "EXPLAIN MATCH (n:N) RETURN n.id; CREATE (:N {id: 5})"
    for result in memory._connection.execute(both):
        result.close()
    assert raw(memory, "MATCH (n:N) RETURN count(*)") == [[5]], MENDED
    with pytest.raises(QueryError, match="one statement"):
        memory.explain(both.removeprefix("EXPLAIN "))


# -- files, locks, transactions -------------------------------------------------------------------------------------


def test_trap_a_checkpoint_of_a_reader_hinders_later_ones(path):
    """What a kill in the midst of a checkpoint leaves too: the handle opens the graph once for writing."""
    damage = "E.Connection(E.Database(sys.argv[1], read_only=True)).execute('CHECKPOINT')"
    run_program(f"import {ENGINE} as E, sys\n{damage}", path)
    assert path.with_name("graph.kuzu.shadow").exists()
    with pytest.raises(RuntimeError, match=r"read-write|recovery"):
        engine().Database(str(path), read_only=True)
    with Graph.open(path, read_only=True) as graph:
        assert graph.query("MATCH (n:N) RETURN count(*) AS n")["n"].to_pylist() == [5000]


def test_trap_closing_the_file_drops_the_engines_lock(path):
    """So nothing opens the file while it is in use, and other processes wait for the lock beside it."""
    other = f"import {ENGINE} as E, sys\nE.Database(sys.argv[1])\nprint('open')"
    database = engine().Database(str(path), max_db_size=1 << 30)
    assert b"lock" in run_program(other, path).stderr
    path.open("rb").close()
    assert run_program(other, path).stdout == b"open\n", MENDED
    # Nor does it keep a second database of this process out.
    engine().Database(str(path), max_db_size=1 << 30).close()
    database.close()
