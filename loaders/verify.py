"""Is the store what was loaded? Every Parquet file by its hash, the graph by its answers.

The interval tables are the record, and the manifest holds their hashes. So the graph is not compared with itself:
each scene table is read out of it whole, with every property, once from either end of its edges (the engine keeps both
directions apart), and compared with the rows that the interval tables give, by a sum of row hashes that no order can
change. The tables of the keyframe layer are compared with the digests in its stamp, taken of the rows before they were
copied.

The file's own checksum tells what no scan can see, such as a damaged index over the keys; where agents have written
into the file since, it cannot hold, and every key of the scene is looked up instead (the engine joins by scans, so its
index answers one key at a time). Keys of the layer are not: they are internal, and no statement looks one up.

A damaged graph can crash the engine or keep it busy for ever: it is read in a process of its own, which is ended when
it takes too much memory, or is silent for too long. After each piece of a table it reports that it is still reading.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

import pyarrow as pa

from jrdb_avr.loaders.digests import Digests, add_digests, digests_of
from jrdb_avr.loaders.graph import RELS, batches, column_names, scene_rows
from jrdb_avr.queries import workers
from jrdb_avr.queries.graph.file import check_fingerprint, fingerprint_of, lock_graph
from jrdb_avr.queries.graph.guard import end_beyond_memory
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.store import Store, file_hash
from jrdb_avr.schema.errors import AvrError, QueryError, StoreError
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, SCENE_NODES, SCENE_RELS

TIMEOUT_S: Final = 120.0
"""For one piece of a table, at least ten times what it needs: `_BATCH_ROWS` rows, or `BATCH_KEYS` keys looked up."""
_BATCH_ROWS: Final = 250_000
"""Rows read out of the graph at a time, unless one sequence has more."""
BATCH_KEYS: Final = 1_000
"""Keys looked up at a time, each in a third of a millisecond and more."""

FILE: Final = "graph file"
UNFINISHED: Final = "keyframe layer, not finished: generate makes it anew"
_LAYER: Final = KEYFRAME_NODES | KEYFRAME_RELS
TABLES: Final = (FILE, *SCENE_NODES, *SCENE_RELS, *_LAYER)
"""What is read of the graph, in order."""

_STAMP: Final = "MATCH (k:Keyframes) RETURN k.sequence AS sequence, k.digests AS digests ORDER BY sequence"

Advance = Callable[[int], None]


@dataclass(frozen=True)
class Check:
    """One part of the store: `checked` files or rows were compared, and `fault` is what is wrong, "" for nothing.

    `reload`: only loading the annotations again mends it; a rebuild does for the rest.
    """

    what: str
    checked: int
    fault: str
    reload: bool = False


def checks_of(store: Store, advance: Advance = lambda steps: None, *, timeout_s: float = TIMEOUT_S) -> list[Check]:
    """Compare a store with its manifest and its graph with its tables; one row per part.

    Raises StoreError where there is no manifest, LockedError while another process writes the graph.
    """
    manifest = store.manifest()
    with lock_graph(store.graph_path, shared=True):
        checks = []
        for part in ("annotations", "intervals"):
            checks.append(_files(store, manifest, part))
            advance(1)
        if checks[-1].fault:
            return [*checks, Check("graph", 0, "not compared: the interval tables are not those it was built from")]
        return [*checks, *_graph(store, sorted(manifest.sequences), advance, timeout_s)]


VERIFY_STEPS: Final = 2 + len(TABLES)
"""How far `advance` comes in all."""


def _files(store: Store, manifest: Manifest, part: str) -> Check:
    """Every file of a part against its hash, and no file that the manifest does not know: views would read it."""
    known = {path: digest for entry in manifest.sequences.values() for path, digest in entry.tables.items()}
    expected = {path: digest for path, digest in known.items() if path.startswith(f"{part}/")}
    results = ((path, _file_fault(store.path / path, digest)) for path, digest in sorted(expected.items()))
    faults = [f"{path} {fault}" for path, fault in results if fault]
    found = {path.relative_to(store.path).as_posix() for path in (store.path / part).rglob("*.parquet")}
    faults += [f"{path} was not written by the load" for path in sorted(found - expected.keys())]
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return Check(part, len(expected), f"{faults[0]}{more}" if faults else "", reload=part == "annotations")


def _file_fault(path: Path, digest: str) -> str:
    try:
        return "" if file_hash(path) == digest else "is not the file that was loaded"
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read: {error.strerror}"


# -- the graph -----------------------------------------------------------------------------------------------------


def _graph(store: Store, sequences: Sequence[str], advance: Advance, timeout_s: float) -> list[Check]:
    try:
        check_fingerprint(store.graph_path)
    except StoreError as error:
        return [Check(FILE, 0, str(error))]
    expected: defaultdict[str, Digests] = defaultdict(dict)
    for table, rows in scene_rows(store, sequences):
        add_digests(expected[table], digests_of(rows.select(column_names(table))))
    checks = []
    for table, answer in _read(store.graph_path, TABLES, timeout_s):
        if isinstance(answer, str):
            checks.append(Check(table, 0, answer))
        elif table == FILE:
            checks.append(Check(FILE, 1, ""))
        elif table not in _LAYER:
            checks.append(_compared(table, expected[table], answer))
        elif len(answer) > 1:
            checks.append(_compared(table, answer[0], answer[1:]))
        elif answer and table == "Keyframes":
            checks.append(Check(UNFINISHED, 0, ""))
        advance(1)
    return checks


def _compared(table: str, expected: Digests, readings: Sequence[Digests]) -> Check:
    faults = [fault for reading in readings if (fault := _difference(expected, reading))]
    return Check(table, sum(rows for rows, _ in expected.values()), faults[0] if faults else "")


def _difference(expected: Digests, found: Digests) -> str:
    """What differs, in a line; "" for nothing."""
    wrong = [name for name in sorted(expected.keys() | found.keys()) if expected.get(name) != found.get(name)]
    if not wrong:
        return ""
    rows, there = (side.get(wrong[0], (0, 0))[0] for side in (expected, found))
    kind = f"{there} rows instead of {rows}" if rows != there else f"other content in {rows} rows"
    where = f" of {wrong[0]}" if wrong[0] else ""
    return f"{kind}{where}" + (f" (and in {len(wrong) - 1} more sequences)" if len(wrong) > 1 else "")


# -- reading it in another process -----------------------------------------------------------------------------------


def _read(path: Path, tables: Sequence[str], timeout_s: float) -> Iterator[tuple[str, list[Digests] | str]]:
    """Each table's digests, one per reading, or what went wrong while it was read.

    Nothing is read after a crash or an endless wait: whatever the rest holds, the graph is to be rebuilt.
    """
    with _child(path, tables) as answers:
        for at, table in enumerate(tables):
            answer = None
            fault = "reading it does not end"
            try:
                while answer is None and answers.poll(timeout_s):
                    answer = answers.recv()
            except (EOFError, OSError):
                fault = "the engine crashed while reading it"
            if answer is not None:
                yield table, answer
                continue
            yield table, fault
            yield from ((other, f"not read, after {table}") for other in tables[at + 1 :])
            return


@contextlib.contextmanager
def _child(path: Path, tables: Sequence[str]) -> Iterator[Connection]:
    ours, theirs = workers.context.Pipe(duplex=False)
    process = workers.context.Process(target=_serve, args=(theirs, str(path), list(tables)), daemon=True)
    process.start()
    theirs.close()
    try:
        yield ours
    finally:
        process.kill()
        process.join()
        ours.close()


def _serve(answers: Connection, path: str, tables: Sequence[str]) -> None:
    """The child: one answer per table, in order, and None for each piece while it reads one."""
    # The parent reports in one line what the engine writes when it gives up.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    threading.Thread(target=end_beyond_memory, args=(lambda: None,), daemon=True).start()
    place = Path(path)
    # Before the database is open here: closing the file would drop the engine's lock on it.
    built, now = check_fingerprint(place), fingerprint_of(place)
    intact, longer = now.crc32 == built.crc32, now.size > built.size
    try:
        graph = Graph.open(place, read_only=True, prepares=True)
    except AvrError as error:
        for _ in tables:
            answers.send(str(error))
        return
    with graph:
        for table in tables:
            try:
                if table == FILE:
                    answers.send([] if intact or longer or inhabited(graph) else "it is not the file that was built")
                else:
                    answers.send(list(_readings(graph, table, not intact, lambda: answers.send(None))))
            except AvrError as error:
                answers.send(str(error))
            except (pa.ArrowException, UnicodeDecodeError, ValueError, RuntimeError) as error:
                answers.send(f"it does not read: {' '.join(str(error).split())[:200]}")


def inhabited(graph: Graph) -> bool:
    """Whether agents have written into the file since it was built: then some of its pages are others."""
    return "Episode" in graph.tables() and bool(graph.query("MATCH (e:Episode) RETURN count(*) AS n")["n"][0].as_py())


def _readings(graph: Graph, table: str, by_key: bool, go_on: Callable[[], None]) -> Iterator[Digests]:
    """A table's digests by every way that a query may take to it; `go_on` is called after each piece.

    Of the keyframe layer the stamped digests come first, and nothing where there is no stamp.
    """
    # The digests in a stamp are not of themselves.
    columns = [name for name in column_names(table) if name != "digests"]
    if table in _LAYER:
        if "Keyframes" not in graph.tables():
            return
        stamp = {row["sequence"]: json.loads(row["digests"]) for row in graph.query(_STAMP).to_pylist()}
        yield {sequence: tuple(digest) for sequence, digests in stamp.items() if (digest := digests.get(table))}
        if not stamp:
            return
    if table in RELS:
        source, target, _ = RELS[table]
        head, tail = (column_names(label)[0] for label in (source.split(":")[0], target))
        owner = "r" if "sequence" in columns else "a"
        listed = "".join(f", r.{name} AS {name}" for name in columns[2:] if name != "sequence")
        groups = _groups(graph, f"(a:{source})-[r:`{table}`]->()", owner)
        for order in ("(a JOIN r) JOIN b", "(b JOIN r) JOIN a"):
            found: Digests = {}
            for sequences in groups:
                rows = graph.query(
                    f"MATCH (a:{source})-[r:`{table}`]->(b:{target}) WHERE {owner}.sequence IN $sequences HINT {order} "
                    f"RETURN {owner}.sequence AS sequence, a.{head} AS `from`, b.{tail} AS `to`{listed}",
                    {"sequences": sequences},
                    ordered=False,
                    timeout_s=TIMEOUT_S,
                )
                add_digests(found, digests_of(rows))
                go_on()
            yield found
        return
    key, listed = columns[0], ", ".join(f"n.{name} AS {name}" for name in columns)
    yield digests_of(graph.query(f"MATCH (n:`{table}`) RETURN {listed}", ordered=False, timeout_s=TIMEOUT_S))
    if by_key and table not in _LAYER:
        keys = graph.query(f"MATCH (n:{table}) RETURN n.{key} AS key", ordered=False)["key"].to_pylist()
        once = [value for value, times in Counter(keys).items() if times == 1]
        lookup = f"MATCH (n:{table}) WHERE n.{key} = $key RETURN {listed}"
        looked_up: Digests = {}
        for start in range(0, len(once), BATCH_KEYS):
            go_on()
            some = once[start : start + BATCH_KEYS]
            rows = [_compact(graph.query(lookup, {"key": value}, ordered=False)) for value in some]
            add_digests(looked_up, digests_of(pa.concat_tables(rows)))
        yield looked_up


def _compact(rows: pa.Table) -> pa.Table:
    """A copy of a few rows: those of the engine lie in buffers of megabytes."""
    return rows.take(list(range(rows.num_rows)))


def _groups(graph: Graph, pattern: str, owner: str) -> list[list[str]]:
    """The sequences of edges, by `owner` in a pattern, in groups that can be read in one piece. Raises QueryError."""
    counts = graph.query(
        f"MATCH {pattern} RETURN {owner}.sequence AS sequence, count(*) AS n ORDER BY sequence", timeout_s=TIMEOUT_S
    )
    sizes = list(zip(counts["sequence"].to_pylist(), counts["n"].to_pylist(), strict=True))
    for sequence, rows in sizes:
        if sequence is None:
            raise QueryError(f"{rows} rows are of no sequence")
    return [sequences for sequences, _ in batches(sizes, _BATCH_ROWS)]
