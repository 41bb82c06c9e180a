"""Statements that the engine is known to answer wrongly, recognized by their plan and their words.

Each was found by comparison with brute force; a test fails when a later engine answers rightly.

- *Cyclic patterns lose parallel edges* where the plan holds INTERSECT: 2 rows for a true 4.
- *A bare boolean after WHEN takes the wrong branch*: in `CASE WHEN x.flag THEN`, but also where the condition is an
  alias, a cast to BOOL or another CASE. `x.flag = true` is right, and so is the simple form, `CASE x.flag WHEN true`.
- *In a grouped RETURN or WITH, what is aggregated after a DISTINCT aggregate is nothing*: `count(DISTINCT a), count(*)`
  gives 0 for the second, `collect` crashes. The other order is right, and so is either where nothing is grouped.
- *A text before a number in ORDER BY* misplaces rows, from some 5,000 on. Numbers before texts are right.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final

from jrdb_avr.queries.graph.parameters import strip_literals
from jrdb_avr.schema.errors import QueryError

_OPERATOR = re.compile(r"\b([A-Z][A-Z_]*)\[\d+\]")
_KEEP_ORDER: Final = frozenset({"RESULT_COLLECTOR", "PROJECTION", "SKIP", "LIMIT", "MULTIPLICITY_REDUCER"})

_CASE = re.compile(r"(?<![\w.])(CASE|WHEN|THEN|END)\b", re.IGNORECASE)
_BARE = re.compile(
    r"(?!(?:true|false|null)$)(?:(?:[A-Za-z_]\w*)?(?: ?\. ?(?:[A-Za-z_]\w*)?)*|CAST [^$]*|CASE .* END)", re.IGNORECASE
)
_SUBQUERY = re.compile(r"(\b(?:EXISTS|COUNT)\s*)?\{([^{}]*)\}", re.IGNORECASE)
_ORDER = re.compile(
    r"(?<![\w.$])ORDER\s+BY\b(.*?)"
    r"(?=(?<![\w.$])(?:(?:SKIP|LIMIT)\s+[\d$]"
    r"|(?:WHERE|OPTIONAL|MATCH|UNWIND|(?<!STARTS )(?<!ENDS )WITH|RETURN|UNION)\b)|$)",
    re.IGNORECASE | re.DOTALL,
)
_WAY = re.compile(r"(?<![\w.$])(?:ASC|DESC)(?:ENDING)?(?=\s*(?:,|$))", re.IGNORECASE)
_KINDS = re.compile(r"Actual:\s*\((.*?),[^,]*\)\s*Expected", re.DOTALL)
_PROJECTION = re.compile(r"(?<![\w.])(?:RETURN|(?<!STARTS )(?<!ENDS )WITH)\b", re.IGNORECASE)
_AFTER_DISTINCT = re.compile(
    r"\(\s*DISTINCT\b.*?\b(?:count|sum|avg|min|max|collect)\s*\((?!\s*DISTINCT\b)", re.IGNORECASE | re.DOTALL
)


class QueryPlan:
    """The engine's plan of one statement."""

    def __init__(self, text: str) -> None:
        # A plan is drawn as a tree of boxes: of a long statement's, megabytes are blanks and lines.
        self.text = " ".join(text.replace("─", "").split())
        self.operators: tuple[str, ...] = tuple(_OPERATOR.findall(self.text))
        # Table functions but the one behind RETURN without MATCH and UNWIND of a list, which reads nothing.
        self.functions = set(re.findall(r"Function: (\w+)", self.text)) - {"READ_FTABLE"}
        # Until it is checked with its statement.
        self.sound = False

    @property
    def writes(self) -> bool:
        """Whether the statement changes nodes, edges or tables, or moves data in or out."""
        return any(
            name in ("SET_PROPERTY", "DELETE", "INSERT", "MERGE", "CREATE_TABLE", "DROP", "ALTER")
            or name.startswith(("COPY", "INDEX_", "EXPORT", "IMPORT", "BATCH_INSERT"))
            for name in self.operators
        )

    @property
    def ordered(self) -> bool:
        """Whether the rows come in a stated order, or there is only one."""
        for name in self.operators:
            if name in _KEEP_ORDER:
                continue
            if name == "AGGREGATE_SCAN":
                box = self.text.split("AGGREGATE_SCAN[", 1)[1].split("└", 1)[0]
                return "Group By:" not in box
            # Ladybug reads the number of edges off the table.
            return name in ("ORDER_BY_SCAN", "TOP_K_SCAN", "COUNT_REL_TABLE")
        return False

    @property
    def groups(self) -> bool:
        """Whether rows are grouped anywhere in it."""
        return "Group By:" in self.text


def refuse_wrong_answers(plan: QueryPlan, text: str, complaint: Callable[[str], str]) -> None:
    """Raise QueryError, with the form to write instead, for a statement that the engine is known to answer wrongly.

    `plan` is the engine's plan of the statement `text`; one that was found sound is not checked again. complaint: what
    the engine says against a statement.
    """
    if plan.sound:
        return
    if "INTERSECT" in plan.operators:
        raise QueryError(
            "the engine would lose rows on this cyclic pattern (its plan holds INTERSECT): split it by WITH, or "
            f"test one side by EXISTS {{ MATCH ... }}: {' '.join(text.split())[:120]}"
        )
    bare = " ".join(strip_literals(text).split())
    for condition in _conditions(bare):
        if _BARE.fullmatch(condition):
            name = condition[:60] or "..."
            raise QueryError(f"the engine answers WHEN {name} THEN wrongly, a bare boolean: write WHEN {name} = true")
    if plan.groups and any(_AFTER_DISTINCT.search(part) for part in _projections(bare)):
        raise QueryError("the engine loses rows of what is counted after a count(DISTINCT ...): put the DISTINCT last")
    for probe in _order_probes(text):
        kinds = [kind.strip() for found in _KINDS.findall(complaint(probe)) for kind in found.split(",")]
        if not kinds:
            raise QueryError("the types of the keys of ORDER BY are not clear: order by columns that are returned")
        if "STRING" in kinds and any(kind != "STRING" for kind in kinds[kinds.index("STRING") :]):
            raise QueryError("the engine misplaces rows by ORDER BY with a text before a number: put the numbers first")
    plan.sound = True


def _conditions(text: str) -> Iterator[str]:
    """The conditions of each searched CASE, without parentheses; names in backticks are gone already."""
    searched: list[bool] = []
    begun: list[int] = []
    for found in _CASE.finditer(text):
        word = found[1].upper()
        if word == "CASE":
            searched.append(bool(re.match(r" ?WHEN\b", text[found.end() :], re.IGNORECASE)))
            begun.append(found.end())
        elif not searched:
            continue
        elif word == "WHEN":
            begun[-1] = found.end()
        elif word == "THEN" and searched[-1]:
            yield " ".join(re.sub("[()]", " ", text[begun[-1] : found.start()]).split())
        elif word == "END":
            searched.pop()
            begun.pop()


def _order_probes(text: str) -> Iterator[str]:
    """The statement once per ORDER BY of several keys, with a function of them that no one has: the engine's complaint
    names their types."""
    for order in _ORDER.finditer(strip_literals(text)):
        if "," in order[1]:
            keys = _WAY.sub("", text[order.start(1) : order.end(1)])
            yield f"{text[: order.start(1)]} lower({keys}, '') {text[order.end(1) :]}"


def _projections(text: str) -> list[str]:
    """What follows each RETURN and WITH, without subqueries, whose aggregates are their own."""
    before = ""
    while before != text:
        before = text
        text = _SUBQUERY.sub(lambda found: " " if found[1] else f"[{found[2]}]", text)
    return _PROJECTION.split(text)[1:]
