"""Format the rows of tables as text: cells for the screen, Markdown, and LaTeX for the package booktabs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.engine.report.tables import PAPER_TABLES, SHARES, TOO_FEW
from jrdb_avr.engine.text_table import clean
from jrdb_avr.queries.display import list_columns

Rows = Sequence[Mapping[str, Any]]

_MARKDOWN: Final = str.maketrans({letter: f"\\{letter}" for letter in "\\`*[]|"} | {"&": "&amp;", "<": "&lt;"})

MARK: Final = "*"
"""Mark that follows the value of `n` if this value differs from the `n` of most runs."""

_PRINTED: Final = ("label", "n", "answer", "evidence", "combined", "hallucination", "invalid")
"""Score columns of the table `main` in a paper, in order. They follow the columns that name the run."""

_SHARE: Final = re.compile(r"n/a|<?-?\d[\d.]*\*?( \[.*\])?( synthetic)?")
"""Pattern of a formatted cell that has a number, possibly with a mark or an interval."""

_LEAST_P: Final = 0.0001


def cell(value: object, column: str = "", decimals: int = 2) -> str:
    """Format a value of a table as text.

    Args:
        value: The value. None becomes "n/a".
        column: The name of the value's column. Floats in the column `p` get four decimals.
        decimals: Number of decimals of floats in all columns other than `p`.

    Returns:
        The text.
    """
    if value is None:
        return "n/a"
    if column == "p" and isinstance(value, float):
        return f"<{_LEAST_P}" if value < _LEAST_P else f"{value:.4f}"
    return f"{value:.{decimals}f}" if isinstance(value, float) else str(value)


def with_intervals(rows: Rows) -> list[dict[str, str]]:
    """Put each share and its interval into one cell, such as `12.50 [8.10, 17.20]`.

    Args:
        rows: Rows of a table. If the column `NAME` has shares, the columns `NAME_low` and `NAME_high` have the bounds
            of their intervals.

    Returns:
        The rows with all values as text. A row with too few sequences has no intervals. If at least one row
        has too few sequences, all rows keep the column `interval`, which says which rows these are. If each run has
        only one row, a mark follows each value of `n` that differs from the most frequent value.
    """
    rows = without_rough(rows)
    few = any(row.get("interval") == TOO_FEW for row in rows)
    marked = other_counts(rows)
    return [
        {
            name: cell(value, name)
            + (MARK if name == "n" and value in marked else "")
            + _bounds(row.get(f"{name}_low"), row.get(f"{name}_high"))
            for name, value in row.items()
            if not name.endswith(("_low", "_high")) and (few or name != "interval")
        }
        for row in rows
    ]


def other_counts(rows: Rows) -> set[int]:
    """Find the values in the column `n` that differ from the most frequent value in this column.

    Args:
        rows: Rows of a table. Rows without a run, and rows of guessers, are ignored.

    Returns:
        The values that differ. If at least one run has several rows, the set is empty.
    """
    of_runs = [row for row in rows if row.get("run") and row.get("method") != ""]
    if len({row["run"] for row in of_runs}) < len(of_runs):
        return set()
    counts = [row["n"] for row in of_runs if "n" in row]
    return set(counts) - set(sorted(counts, key=lambda n: (-counts.count(n), -n))[:1])


def for_paper(name: str, rows: Rows) -> list[dict[str, Any]]:
    """Format the rows of a report's table, with intervals, so that the table can be printed in a paper.

    Args:
        name: The name of the table.
        rows: The rows of the table.

    Returns:
        The rows with all values as text. Synthetic figures in a table of `PAPER_TABLES` are called so. If the table is
        `main`, the macro averages are left out, and the rows are
        grouped by model. The groups are in the order of the first rows of their models.
    """
    printed: list[dict[str, Any]] = with_intervals(rows)
    if name in PAPER_TABLES:
        for row, source in zip(printed, rows, strict=True):
            if source.get("run", "") is None:
                row |= {column: "" for column in row if source.get(column) is None}
            elif "synthetic" in source["label"]:
                # A synthetic figure must not be mistaken for a result beside the paper's.
                row |= {column: f"{row[column]} synthetic" for column in ("n", *SHARES) if column in row}
        hidden = ["label", *(["setting"] if not any(row.get("setting") for row in printed) else [])]
        return [{column: text for column, text in row.items() if column not in hidden} for row in printed]
    if name != "main":
        return printed
    models = [row["model"] for row in printed]
    printed = sorted(printed, key=lambda row: models.index(row["model"]))
    printed = [row | {"method": row["method"] or row["run"]} for row in printed]
    names = [(row["model"], row["method"], row.get("setting", "")) for row in printed]
    settings = ["setting"] if any(row.get("setting") for row in printed) else []
    # If rows are equal in these columns, the run id tells them apart.
    ids = ["run"] if len(set(names)) < len(names) else []
    few = ["interval"] if any("interval" in row for row in printed) else []
    columns = ["model", "method", *settings, *ids, *_PRINTED, *few]
    return [{key: row.get(key, "") for key in columns} for row in printed]


def paper_caption(name: str, rows: Rows) -> str:
    """Return the caption of a table of `PAPER_TABLES`, or "" for any other table.

    Args:
        name: The name of the table.
        rows: The rows of the table.

    Returns:
        The caption. It says if the store's figures are synthetic.
    """
    if name not in PAPER_TABLES:
        return ""
    synthetic = (
        "; the figures of this store are synthetic"
        if any("synthetic" in (row.get("label") or "") for row in rows)
        else ""
    )
    return f"{PAPER_TABLES[name]}, beside this store [95 % interval] and the difference{synthetic}"


def without_rough(rows: Rows) -> list[dict[str, Any]]:
    """Remove the bounds of intervals from each row that has too few sequences for an interval.

    Args:
        rows: Rows with a column `interval`.

    Returns:
        The rows. Removed bounds are None.
    """
    return [
        {
            name: None if name.endswith(("_low", "_high")) and row.get("interval") == TOO_FEW else value
            for name, value in row.items()
        }
        for row in rows
    ]


def _bounds(low: object, high: object) -> str:
    return "" if low is None or high is None else f" [{cell(low)}, {cell(high)}]"


def markdown(rows: Rows) -> str:
    """Return rows as a Markdown table.

    Args:
        rows: The rows. `cell` formats their values.

    Returns:
        The table as text that ends in a line break.
    """
    cells = [[text.translate(_MARKDOWN) for text in line] for line in _lines_of(rows)]
    return _tabulated(rows, cells, list_columns(rows), "pipe")


def latex(rows: Rows, title: str = "") -> str:
    """Return rows as a LaTeX table for the package booktabs.

    If values repeat in the first column, horizontal lines separate the groups of equal values. Settings are long,
    so a cell of the column `setting` has only the number of a note. The notes are below the table.

    Args:
        rows: The rows. `cell` formats their values.
        title: The first note, or "".

    Returns:
        A `tabular` environment, followed by the notes.
    """
    from tabulate import LATEX_ESCAPE_RULES, SEPARATING_LINE

    notes = list(dict.fromkeys(row["setting"] for row in rows if row.get("setting")))
    numbers = {note: str(note_number) for note_number, note in enumerate(notes, 1)}
    rows = [{**row, "setting": numbers.get(row.get("setting", ""), "")} for row in rows] if notes else rows
    cells: list[Any] = _lines_of(rows)
    if len({line[0] for line in cells}) < len(cells):
        for index in range(len(cells) - 1, 0, -1):
            if cells[index][0] != cells[index - 1][0]:
                cells.insert(index, SEPARATING_LINE)
    text = _tabulated(rows, cells, [name.replace("_", " ") for name in list_columns(rows)], "latex_booktabs")
    # A bracket at the start of a row gets braces. LaTeX would take it for an argument of the previous row's end.
    text = re.sub(r"^( *)\[", r"\1{[}", text, flags=re.MULTILINE)
    escapes = str.maketrans(LATEX_ESCAPE_RULES)
    explained = [title] * bool(title) + [f"{mark}: {_in_one_line(note)}" for note, mark in numbers.items()]
    return text + "".join(rf"\par{{\footnotesize {line.translate(escapes)}}}" + "\n" for line in explained)


def _tabulated(rows: Rows, cells: Sequence[Any], heads: Sequence[str], form: str) -> str:
    from tabulate import tabulate

    sides = ["right" if _is_number(rows, name) else "left" for name in list_columns(rows)]
    return f"{tabulate(cells, heads, form, disable_numparse=True, colalign=sides)}\n"


def _lines_of(rows: Rows) -> list[list[str]]:
    columns = list_columns(rows)
    return [[_in_one_line(cell(row.get(name, ""), name)) for name in columns] for row in rows]


def _in_one_line(text: str) -> str:
    return clean(" ".join(text.split()))


def _is_number(rows: Rows, name: str) -> bool:
    values = [row[name] for row in rows if row.get(name) not in (None, "")]
    numbers = (isinstance(value, int | float) or _SHARE.fullmatch(str(value)) for value in values)
    return bool(values) and name != "setting" and all(numbers)


def filled(rows: Rows) -> list[dict[str, Any]]:
    """Give all rows the same columns.

    Args:
        rows: The rows.

    Returns:
        The rows. If a row lacked a column, its value in this column is an empty text.
    """
    columns = list_columns(rows)
    return [{name: row.get(name, "") for name in columns} for row in rows]
