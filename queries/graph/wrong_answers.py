"""Checks that refuse statements which the engine is known to answer wrongly.

The checks look at the plan and at the keywords of a statement. The list below has the known faults of the engine. Each
fault was found by a comparison of the engine with a brute-force search. For each fault, a test fails if a later version
of the engine answers correctly. The check for the fault can then be removed.

- *Cyclic patterns lose parallel edges*. If the plan has INTERSECT, the engine may return 2 rows instead of 4.
- *A bare boolean after WHEN takes the wrong branch*, as in `CASE WHEN x.flag THEN`. An alias, a cast to BOOL or a CASE
  after WHEN has the same effect. `WHEN x.flag = true` and `CASE x.flag WHEN true` are answered correctly.
- *Aggregates after a DISTINCT aggregate are empty* if the RETURN or WITH clause forms groups of rows. In
  `count(DISTINCT a), count(*)`, the second value is 0. If `collect` replaces `count(*)`, the engine crashes.
  `count(*), count(DISTINCT a)` is answered correctly.
- *Rows are in the wrong order if ORDER BY has a text before a number* and there are more than about 5,000 rows. If the
  numbers come before the texts, the order is correct.
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
_DIRECTION = re.compile(r"(?<![\w.$])(?:ASC|DESC)(?:ENDING)?(?=\s*(?:,|$))", re.IGNORECASE)
_KINDS = re.compile(r"Actual:\s*\((.*?),[^,]*\)\s*Expected", re.DOTALL)
_PROJECTION = re.compile(r"(?<![\w.])(?:RETURN|(?<!STARTS )(?<!ENDS )WITH)\b", re.IGNORECASE)
_AFTER_DISTINCT = re.compile(
    r"\(\s*DISTINCT\b.*?\b(?:count|sum|avg|min|max|collect)\s*\((?!\s*DISTINCT\b)", re.IGNORECASE | re.DOTALL
)


class QueryPlan:
    """Plan that the engine made for a statement.

    Attributes:
        text: Text of the plan in one line.
        operators: Names of the plan's operators. The last operator to run is first in the tuple.
        functions: Names of the table functions that the statement calls.
        sound: Whether `refuse_wrong_answers` has accepted the statement.
    """

    def __init__(self, text: str) -> None:
        # The engine draws the plan as a tree of boxes. For a long statement, the drawing has megabytes of blanks.
        self.text = " ".join(text.replace("─", "").split())
        self.operators: tuple[str, ...] = tuple(_OPERATOR.findall(self.text))
        # Exclude READ_FTABLE, which reads no outside data. The engine uses it for UNWIND and for RETURN without MATCH.
        self.functions = set(re.findall(r"Function: (\w+)", self.text)) - {"READ_FTABLE"}
        self.sound = False

    @property
    def writes(self) -> bool:
        """Whether the statement changes nodes, edges or tables, imports data, or exports data."""
        return any(
            name in ("SET_PROPERTY", "DELETE", "INSERT", "MERGE", "CREATE_TABLE", "DROP", "ALTER")
            or name.startswith(("COPY", "INDEX_", "EXPORT", "IMPORT", "BATCH_INSERT"))
            for name in self.operators
        )

    @property
    def ordered(self) -> bool:
        """Whether the statement orders its rows or returns only one row."""
        for name in self.operators:
            if name in _KEEP_ORDER:
                continue
            if name == "AGGREGATE_SCAN":
                box = self.text.split("AGGREGATE_SCAN[", 1)[1].split("└", 1)[0]
                return "Group By:" not in box
            # COUNT_REL_TABLE, an operator of the engine ladybug, returns one row: the number of edges of a table.
            return name in ("ORDER_BY_SCAN", "TOP_K_SCAN", "COUNT_REL_TABLE")
        return False

    @property
    def groups(self) -> bool:
        """Whether the plan groups rows by a key, for example for `RETURN a.name, count(*)`."""
        return "Group By:" in self.text


def refuse_wrong_answers(plan: QueryPlan, text: str, complaint: Callable[[str], str]) -> None:
    """Refuse a statement that the engine is known to answer wrongly.

    Args:
        plan: Plan of the statement. If the statement is accepted, the attribute `sound` of the plan becomes true, so
            that a second check of the plan returns at once.
        text: Statement.
        complaint: Function that returns the engine's error message for an invalid statement. It is called with
            invalid variants of `text`, because the error messages about these variants name the types of columns.

    Raises:
        QueryError: If the engine would answer wrongly. The message says how to change the statement.
    """
    if plan.sound:
        return
    if "INTERSECT" in plan.operators:
        raise QueryError(
            "the engine would lose rows of this cyclic pattern (the plan has INTERSECT): split the pattern by WITH, or "
            f"test one side by EXISTS {{ MATCH ... }}: {' '.join(text.split())[:120]}"
        )
    bare = " ".join(strip_literals(text).split())
    for condition in _conditions(bare):
        if _BARE.fullmatch(condition):
            name = condition[:60] or "..."
            raise QueryError(f"the engine answers WHEN {name} THEN wrongly, a bare boolean: write WHEN {name} = true")
    if plan.groups and any(_AFTER_DISTINCT.search(part) for part in _projections(bare)):
        raise QueryError("the engine returns wrong aggregates after a count(DISTINCT ...): put the DISTINCT last")
    for probe in _order_probes(text):
        kinds = [kind.strip() for types in _KINDS.findall(complaint(probe)) for kind in types.split(",")]
        if not kinds:
            raise QueryError("the types of the columns in ORDER BY are not known: order by columns that are returned")
        if "STRING" in kinds and any(kind != "STRING" for kind in kinds[kinds.index("STRING") :]):
            raise QueryError("the engine misplaces rows by ORDER BY with a text before a number: put the numbers first")
    plan.sound = True


def _conditions(text: str) -> Iterator[str]:
    """Yield each condition between WHEN and THEN of a CASE without an operand.

    `text` must have no quoted texts. Parentheses are removed from the conditions.
    """
    searched: list[bool] = []
    begun: list[int] = []
    for match in _CASE.finditer(text):
        word = match[1].upper()
        if word == "CASE":
            searched.append(bool(re.match(r" ?WHEN\b", text[match.end() :], re.IGNORECASE)))
            begun.append(match.end())
        elif not searched:
            continue
        elif word == "WHEN":
            begun[-1] = match.end()
        elif word == "THEN" and searched[-1]:
            yield " ".join(re.sub("[()]", " ", text[begun[-1] : match.start()]).split())
        elif word == "END":
            searched.pop()
            begun.pop()


def _order_probes(text: str) -> Iterator[str]:
    """Yield an invalid variant of the statement for each ORDER BY with several keys.

    A variant serves to find out the types of the keys. It calls `lower` with all keys, and the engine's error message
    about this call names the type of each key.
    """
    for order in _ORDER.finditer(strip_literals(text)):
        if "," in order[1]:
            keys = _DIRECTION.sub("", text[order.start(1) : order.end(1)])
            yield f"{text[: order.start(1)]} lower({keys}, '') {text[order.end(1) :]}"


def _projections(text: str) -> list[str]:
    """Return the text after each RETURN and WITH. Subqueries are removed, because they have their own groups."""
    before = ""
    while before != text:
        before = text
        text = _SUBQUERY.sub(lambda match: " " if match[1] else f"[{match[2]}]", text)
    return _PROJECTION.split(text)[1:]
