"""Rows as text: Markdown, LaTeX (booktabs), and cells as a person reads them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.engine.report.tables import TOO_FEW
from jrdb_avr.engine.text_table import clean
from jrdb_avr.queries.display import columns_of

Rows = Sequence[Mapping[str, Any]]

_LATEX: Final = str.maketrans(
    {letter: f"\\{letter}" for letter in "&%$#_{}"}
    | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        # After the end of a row, and after a rule, a bracket would open an optional argument.
        "[": "{[}",
        "]": "{]}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
    }
)

_MARKDOWN: Final = str.maketrans({letter: f"\\{letter}" for letter in "\\`*[]|"} | {"&": "&amp;", "<": "&lt;"})

MARK: Final = "*"
"""Behind the n of a run that has another number of questions than most."""

_PRINTED: Final = ("label", "n", "answer", "evidence", "combined", "hallucination", "invalid")
"""Score columns of the printed table `main`, in the order in which papers have them; the run's names come before."""

_SHARE: Final = re.compile(r"n/a|<?-?\d[\d.]*\*?( \[.*\])?")
"""A cell of a column of numbers."""

_LEAST_P: Final = 0.0001


def cell(value: object, column: str = "", decimals: int = 2) -> str:
    """A value of a column as a person reads it: n/a for an unknown value; a p has four decimals."""
    if value is None:
        return "n/a"
    if column == "p" and isinstance(value, float):
        return f"<{_LEAST_P}" if value < _LEAST_P else f"{value:.4f}"
    return f"{value:.{decimals}f}" if isinstance(value, float) else str(value)


def with_intervals(rows: Rows) -> list[dict[str, str]]:
    """Format rows with a share and its interval in one column, `12.50 [8.10, 17.20]`.

    Rows of too few sequences have no intervals, and a column `interval` says so. In tables of runs, `n` has a mark
    where it is another one than that of most runs.
    """
    rows = without_rough(rows)
    few = any(row.get("interval") == TOO_FEW for row in rows)
    other = other_counts(rows)
    return [
        {
            name: cell(value, name)
            + (MARK if name == "n" and value in other else "")
            + _bounds(row.get(f"{name}_low"), row.get(f"{name}_high"))
            for name, value in row.items()
            if not name.endswith(("_low", "_high")) and (few or name != "interval")
        }
        for row in rows
    ]


def other_counts(rows: Rows) -> set[int]:
    """The `n` of runs that are not that of most of them; none in tables that have several rows of a run."""
    runs = [row["n"] for row in rows if row.get("run") and "n" in row] if _of_runs(rows) else []
    return set(runs) - set(sorted(runs, key=lambda n: (-runs.count(n), -n))[:1])


def for_paper(name: str, rows: Rows) -> list[dict[str, Any]]:
    """The rows of a report's table as a paper prints them, with their intervals.

    Those of `main` lack macro averages; the runs of a model stand together, the best model first.
    """
    found: list[dict[str, Any]] = with_intervals(rows)
    if name != "main":
        return found
    models = [row["model"] for row in found]
    found = sorted(found, key=lambda row: models.index(row["model"]))
    names = [(row["model"], row["method"], row.get("setting", "")) for row in found]
    settings = ["setting"] if any(row.get("setting") for row in found) else []
    # Rows that are alike in all of these are distinguished by the ids of their runs.
    ids = ["run"] if len(set(names)) < len(names) else []
    few = ["interval"] if any("interval" in row for row in found) else []
    columns = ["model", "method", *settings, *ids, *_PRINTED, *few]
    texts = ("setting", "interval")
    return [{key: row.get(key, "" if key in texts else None) for key in columns} for row in found]


def without_rough(rows: Rows) -> list[dict[str, Any]]:
    """The rows, without the bounds of intervals in those of too few sequences."""
    return [
        {
            name: None if name.endswith(("_low", "_high")) and row.get("interval") == TOO_FEW else value
            for name, value in row.items()
        }
        for row in rows
    ]


def _of_runs(rows: Rows) -> bool:
    """Whether each run has one row at most."""
    names = [row["run"] for row in rows if row.get("run")]
    return len(set(names)) == len(names)


def _bounds(low: object, high: object) -> str:
    return "" if low is None or high is None else f" [{cell(low)}, {cell(high)}]"


def markdown(rows: Rows) -> str:
    """A Markdown table."""
    columns = columns_of(rows)
    lines = [columns, ["---:" if _is_number(rows, name) else "---" for name in columns]]
    lines += [[_escaped(cell(row.get(name), name), _MARKDOWN) for name in columns] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def latex(rows: Rows) -> str:
    """A LaTeX table for the package booktabs; rules between the values of the first column where some repeat.

    A column of settings, which are long, has numbers, and lines below the table explain them.
    """
    rows, notes = _numbered(rows)
    columns = columns_of(rows)
    layout = "".join("r" if _is_number(rows, name) else "l" for name in columns)
    lines = [rf"\begin{{tabular}}{{{layout}}}", r"\toprule", _latex_row([name.replace("_", " ") for name in columns])]
    first = [row.get(columns[0]) for row in rows]
    grouped = len(set(first)) < len(first)
    for place, row in enumerate(rows):
        lines += [r"\midrule"] if not place or (grouped and first[place] != first[place - 1]) else []
        lines.append(_latex_row([cell(row.get(name), name) for name in columns]))
    lines += [r"\bottomrule", r"\end{tabular}"]
    lines += [rf"\par{{\footnotesize {number}: {_escaped(note, _LATEX)}}}" for number, note in enumerate(notes, 1)]
    return "\n".join([*lines, ""])


def _numbered(rows: Rows) -> tuple[Rows, list[str]]:
    """Rows with each distinct setting as its number, and the settings in the order of their numbers."""
    notes = list(dict.fromkeys(row["setting"] for row in rows if row.get("setting")))
    if not notes:
        return rows, []
    places = {note: str(number) for number, note in enumerate(notes, 1)}
    return [{**row, "setting": places.get(row.get("setting", ""), "")} for row in rows], notes


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(_escaped(text, _LATEX) for text in cells) + r" \\"


def _escaped(text: str, letters: dict[int, str]) -> str:
    """A text in one line, with the letters that mean something else escaped."""
    return clean(" ".join(text.split())).translate(letters)


def _is_number(rows: Rows, name: str) -> bool:
    values = [row.get(name) for row in rows if row.get(name) is not None]
    numbers = (isinstance(value, int | float) or _SHARE.fullmatch(str(value)) for value in values)
    return bool(values) and all(numbers)


def filled(rows: Rows) -> list[dict[str, Any]]:
    """Rows that all have every column; a missing value is empty."""
    columns = columns_of(rows)
    return [{name: row.get(name, "") for name in columns} for row in rows]
