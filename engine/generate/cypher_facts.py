"""Facts of people that statements over the stored graph return, for many questions at a time.

`CypherFacts` notes each fact that is asked for and not known yet. `complete` then runs one statement per kind of fact,
with all noted facts as rows of its parameter `$asked`.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from jrdb_avr.engine.generate.facts import WORDS, Facts, Fit, Key
from jrdb_avr.engine.generate.perturb import MissingFactsError
from jrdb_avr.queries.compiler.reads import Person, SceneReader
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.labels import POSES, ROBOT_SECTORS, may_be_called
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import LoadRules

_AT_ONCE: Final = defaultdict(lambda: 500, condition_interaction=50)
"""Maximum number of rows of each statement, because the memory of the engine is bounded.

For each row of `condition_interaction` the engine keeps all interactions of all people in a frame.
"""

_BETWEEN: Final = ("start", "onsets", "count")
"""Kinds of facts about frames between keyframes."""

_BY_READS: Final = ("seen", "start", "count")
"""Kinds of facts that the compiler's reads return. Their statements in `queries/reads/scene` have the same names."""


_K = TypeVar("_K")
_T = TypeVar("_T")


class CypherFacts:
    """Source of facts for `perturb` that asks the graph in rounds.

    Attributes:
        asked: Keys that were asked for, without those that the sets answered. Callers may empty this set.
    """

    def __init__(self, graph: Graph, rules: LoadRules, sets: Facts | None = None) -> None:
        """Make a source that knows nothing yet.

        Args:
            graph: Graph with the scenes.
            rules: Thresholds of sectors and of directions between people.
            sets: Sets of facts at keyframes that statements need not look up, or None.
        """
        self._sets = sets
        self._reader = SceneReader(graph, rules)
        self.asked: set[Key] = set()
        self._known: dict[Key, Any] = {}
        self._noted: set[Key] = set()
        self._keyframes: dict[str, list[int]] = {}

    def ask(self, keys: Sequence[Key]) -> list[Any]:
        """Return facts by key. Raises MissingFactsError if some are not known yet; `complete` looks them up."""
        if self._sets is not None and keys[0][0] not in _BETWEEN:
            return self._sets.ask(keys)
        self.asked.update(keys)
        missing = [key for key in keys if key not in self._known]
        if missing:
            self._noted.update(missing)
            raise MissingFactsError
        return [self._known[key] for key in keys]

    def _fill(self) -> None:
        """Look up all noted facts."""
        by_statement: dict[str, list[Key]] = defaultdict(list)
        for key in sorted(self._noted, key=repr):
            by_statement[statement_of(key)].append(key)
        for name, keys in by_statement.items():
            size = _AT_ONCE[name]
            for first in range(0, len(keys), size):
                self._look_up(name, keys[first : first + size])
        self._noted.clear()

    def complete(self, function: Callable[[], _T]) -> _T:
        """Call a function until it returns, and look up the facts that it lacks between calls. Return its value."""
        return self.complete_all({0: function})[0]

    def complete_all(
        self, functions: Mapping[_K, Callable[[], _T]], advance: Callable[[int], None] = lambda count: None
    ) -> dict[_K, _T]:
        """Call functions until all have returned a value. Look up the facts that they lack together.

        Args:
            functions: Functions by key.
            advance: Function that receives the number of functions that have just returned.

        Returns:
            The values by key.
        """
        values: dict[_K, _T] = {}
        while waiting := functions.keys() - values.keys():
            for key in waiting:
                with contextlib.suppress(MissingFactsError):
                    values[key] = functions[key]()
            advance(len(waiting & values.keys()))
            self._fill()
        return values

    def keyframes(self, sequence: str) -> list[int]:
        """Return the keyframes of a sequence, in order."""
        if sequence not in self._keyframes:
            rows = self._reader.query(read_statement("search/frames.cypher"), {"sequence": sequence})
            self._keyframes[sequence] = [row["frame"] for row in rows if row["keyframe"]]
        return self._keyframes[sequence]

    def statement(self, name: str, keys: Sequence[Key]) -> tuple[str, dict[str, Any]]:
        """Return the statement of some facts of one kind.

        Args:
            name: Name of the statement, as `statement_of` returns it.
            keys: Keys of the facts.

        Returns:
            The text of the statement, and the values of its parameters.
        """
        rows = [row_of(key) | {"id": number} for number, key in enumerate(keys)]
        if name in _BY_READS:
            rows = self._reader.rows_on_grid(rows) if name == "start" else rows
            text, values = read_statement(f"reads/scene/{name}.cypher"), {"plans": rows}
        else:
            text, values = read_statement(f"necessity/{name}.cypher"), {"asked": rows}
        return text, self._reader.with_values(text, values)

    def _look_up(self, name: str, keys: Sequence[Key]) -> None:
        if name in _BY_READS:
            self._known |= zip(keys, self._read(name, keys), strict=True)
            return
        text, values = self.statement(name, keys)
        if name == "labels":
            listed = self._reader.listed_actions(values["asked"])
            self._known |= {key: listed.get(number) for number, key in enumerate(keys)}
            return
        rows: dict[int, list[dict[str, Any]]] = defaultdict(list)
        for row in self._reader.query(text, values):
            rows[row["id"]].append(row)
        for number, key in enumerate(keys):
            found = rows[number]
            if name == "onsets":
                self._known[key] = [
                    tuple(row[part] for part in ("frame", "angle", "could", "certain")) for row in found
                ]
            else:
                certain = {row["who"] for row in found if row["certain"]}
                self._known[key] = Fit({row["who"] for row in found}, certain)

    def _read(self, name: str, keys: Sequence[Key]) -> list[Any]:
        """Return facts of one kind (`name`) that the reads of the compiler look up."""
        asked: list[Any] = [(Person(i, scope, track), *rest) for i, (_, scope, track, *rest) in enumerate(keys)]
        if name == "seen":
            seen = self._reader.seen(asked)
            return [seen[i, key[3]] for i, key in enumerate(keys)]
        if name == "count":
            counts = self._reader.counts(asked)
            return [counts.get(i) for i in range(len(keys))]
        starts = self._reader.starts(asked)
        return [FrameViewpoint(starts[i].start, starts[i].angle) if i in starts else None for i in range(len(keys))]


def statement_of(key: Key) -> str:
    """Return the name of the statement of a fact: a file in `queries/necessity`, or a read of the compiler."""
    kind = key[0]
    if kind == "match":
        return "condition_word" if key[2].attribute in WORDS else f"condition_{key[2].kind}"
    if kind == "follow":
        relation = RELATIONS[key[2]].kind
        return f"relation_{relation}" if relation in ("group", "window") else "relation_pair"
    return str(kind)


def row_of(key: Key) -> dict[str, Any]:
    """Return the row that asks for a fact, for the list `$asked` or `$plans` of its statement."""
    kind, scope, *about = key
    if kind == "onsets":
        track, action, frame = about
        return {"scope": scope, "person": f"{scope}/{track}", "t": frame, "v": action, "posture": action in POSES}
    if kind == "start":
        track, action, after = about
        return {"scope": scope, "who": track, "action": action, "posture": action in POSES, "after": after}
    frame = about[-1]
    if kind in _BY_READS:
        return {"scope": scope, "who": about[0], "t": frame}
    row: dict[str, Any] = {"scope": scope, "at": f"{scope}/{frame:06d}", "t": frame}
    if kind == "match":
        return row | _condition_values(about[0])
    if kind == "labels":
        return row | {"person": f"{scope}/{about[0]}"}
    if kind == "follow":
        relation = RELATIONS[about[0]]
        row["person"] = f"{scope}/{about[1]}"
        if relation.kind == "window":
            return row | {"v": float(relation.degrees), "side": 1 if relation.side == "left" else -1}
        return row | {"v": relation.label, "kind": relation.kind}
    return row


def _condition_values(condition: Condition) -> dict[str, Any]:
    if condition.kind == "sector":
        return {"v": ROBOT_SECTORS[str(condition.value)]}
    if condition.attribute in WORDS:
        possible = may_be_called(str(condition.value)) | {condition.value}
        return {"v": condition.value, "w": sorted(WORDS[condition.attribute] - possible), "kind": condition.attribute}
    if condition.object is not None:
        return {"v": condition.object, "w": condition.verb}
    return {"v": condition.value or condition.action or condition.interaction}
