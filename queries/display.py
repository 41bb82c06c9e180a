"""Progress reports of long functions, and the display of results in a console or a notebook."""

from __future__ import annotations

import html
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

Progress = Callable[[str, int, int], None]
"""Function that is called at the start of a task, and whenever steps of the task have finished.

Its arguments are the name of the task, the number of steps finished so far, and the total number of steps.
"""

_Rows = Sequence[Mapping[str, Any]]
Tables = Mapping[str, _Rows]
"""Rows of each table, by the title of the table."""

MAX_ROWS: Final = 100
"""Maximum number of rows of a table that a notebook displays."""


def step_counter(progress: Progress | None, what: str, total: int) -> Callable[[int], None]:
    """Return a function that counts finished steps and reports the count to `progress`.

    The count 0 is reported before this function returns.

    Args:
        progress: Function that receives the reports, or None for no reports.
        what: Name of the task.
        total: Total number of steps.

    Returns:
        A function. Call it with the number of steps that have just finished, or without an argument for one step.
    """
    done = 0

    def advance(steps: int = 1) -> None:
        nonlocal done
        done += steps
        if progress is not None:
            progress(what, done, total)

    advance(0)
    return advance


def list_columns(rows: _Rows) -> list[str]:
    """Return the names of all columns in the given rows, in the order of their first appearance."""
    return list(dict.fromkeys(name for row in rows for name in row))


class Displayed(ABC):
    """Base class of results. `repr` gives a summary in one line. A notebook displays the summary and the tables."""

    @abstractmethod
    def _summary(self) -> str: ...

    def _tables(self) -> Tables:
        return {}

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._summary()}>"

    def _repr_html_(self) -> str:
        tables = [_html_table(title, rows) for title, rows in self._tables().items() if rows]
        return f"<p>{html.escape(repr(self))}</p>{''.join(tables)}"


def _html_table(title: str, rows: _Rows) -> str:
    columns = list_columns(rows)
    lines = [[row.get(name) for name in columns] for row in rows[:MAX_ROWS]]
    body = "".join(f"<tr>{_html_cells('td', line)}</tr>" for line in lines)
    more = f" ({MAX_ROWS} of {len(rows)} rows)" if len(rows) > MAX_ROWS else ""
    caption = f"<caption>{html.escape(title)}{more}</caption>"
    return f"<table>{caption}<tr>{_html_cells('th', columns)}</tr>{body}</table>"


def _html_cells(tag: str, values: Sequence[object]) -> str:
    texts = ("" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value) for value in values)
    return "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in texts)
