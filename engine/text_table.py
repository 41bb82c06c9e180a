"""Rows as text tables that fit a width without splitting a word or number: columns are wrapped between words first; a
table that is still too wide is turned where it has few rows, and otherwise stands in parts below each other."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")

_LONG: Final = re.compile(r"\S{41,}")

_TURNED: Final = 3
"""A wide table of at most so many rows is printed with a row's values below each other."""

_KEYS: Final = 3
"""Most columns that stand in each part of a table, so that its rows can be told apart."""

_INNER: Final = ("_ID", "_SRC", "_DST", "_LABEL")
"""Fields of a node or relation that are the engine's own."""


def clean(value: object) -> str:
    """The value as text that cannot move a terminal's cursor or change its colours."""
    return _CONTROL.sub("", "" if value is None else str(value))


def cell_text(value: object) -> str:
    """A cell as a person reads it: six digits of a number, and nodes, relations and paths of the graph as in Cypher.

    >>> cell_text({"_ID": 0, "_LABEL": "Person", "track": 3, "age": None})
    '(:Person {track: 3})'
    """
    if isinstance(value, float):
        return f"{value:.0f}" if 1e6 <= abs(value) < 1e15 else f"{value:.6g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(cell_text, value))}]"
    if isinstance(value, dict):
        return _graph_text(value)
    # What is so long is no word, but JSON or a list of names: lines may end at its commas.
    return _LONG.sub(lambda found: found[0].replace(",", ", "), clean(value))


def _graph_text(value: dict[str, Any]) -> str:
    if value.keys() == {"_NODES", "_RELS"}:
        return _path_text(value["_NODES"] or [], value["_RELS"] or [])
    inner = _INNER if "_LABEL" in value else ()
    parts = [f"{clean(name)}: {cell_text(own)}" for name, own in value.items() if name not in inner and own is not None]
    properties = f"{{{', '.join(parts)}}}"
    if "_LABEL" not in value:
        return properties
    label = f":{clean(value['_LABEL'])}" + (f" {properties}" if parts else "")
    return f"[{label}]" if "_SRC" in value else f"({label})"


def _path_text(nodes: Sequence[dict[str, Any]], relations: Sequence[dict[str, Any]]) -> str:
    text = cell_text(nodes[0]) if nodes else ""
    for relation, before, after in zip(relations, nodes, nodes[1:], strict=False):
        forward = relation.get("_SRC") == before.get("_ID")
        text += f"{'-' if forward else '<-'}{cell_text(relation)}{'->' if forward else '-'}{cell_text(after)}"
    return text


def tables(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], width: int) -> list[Any]:
    """The rows as one or more `rich` tables of at most `width` characters, wider only where a single word is."""
    names = columns or list(dict.fromkeys(name for row in rows for name in row))
    numeric = {name for name in names if _numeric([row.get(name) for row in rows])}
    cells = [{name: cell_text(row.get(name)) for name in names} for row in rows]
    if _least(cells, names) <= width:
        return [_table(cells, names, numeric, width)]
    if turned := _turned(cells, names, width):
        return [turned]
    key = _key(cells, names, width)
    parts: list[list[str]] = []
    part = list(key)
    for name in names[len(key) :]:
        if len(part) > len(key) and _least(cells, [*part, name]) > width:
            parts, part = [*parts, part], list(key)
        part.append(name)
    return [_table(cells, own, numeric, width) for own in [*parts, part]]


def _turned(cells: Sequence[dict[str, str]], names: Sequence[str], width: int) -> Any | None:
    """A few rows as a table with a column for each, headed by its first cell; None where that does not fit either."""
    first, rest = names[0], names[1:]
    headings = [first, *(own[first] for own in cells)]
    if not 1 <= len(cells) <= _TURNED or len(set(headings)) < len(headings):
        return None
    turned = [{first: name, **{own[first]: own[name] for own in cells}} for name in rest]
    fits = len(cells) == 1 or _least(turned, headings) <= width
    return _table(turned, headings, set(), width) if fits else None


def _key(cells: Sequence[dict[str, str]], names: Sequence[str], width: int) -> list[str]:
    """The first columns that tell the rows apart, as far as they leave half the width, and room for every other."""
    for count in range(1, _KEYS + 1):
        key = list(names[:count])
        most = max((_least(cells, [name]) - 1 for name in names[count:]), default=0)
        if _least(cells, key) > min(width / 2, width - most):
            return key[:-1] or key
        if len({tuple(own[name] for name in key) for own in cells}) == len(cells):
            return key
    return list(names[:1])


def _least(cells: Sequence[dict[str, str]], names: Sequence[str]) -> int:
    """The width of the narrowest table that splits no word."""
    return sum(_widest(cells, name, str.split) + 3 for name in names) + 1


def _widest(cells: Sequence[dict[str, str]], name: str, split: Any) -> int:
    from rich.cells import cell_len

    return max(
        (cell_len(part) for text in (clean(name), *(own[name] for own in cells)) for part in split(text)), default=0
    )


def _numeric(values: Sequence[object]) -> bool:
    known = [value for value in values if value is not None]
    return bool(known) and all(isinstance(value, int | float) for value in known)


def _table(cells: Sequence[dict[str, str]], names: Sequence[str], numeric: set[str], width: int) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for name, own in zip(names, _widths(cells, names, width), strict=True):
        table.add_column(Text(clean(name)), justify="right" if name in numeric else "left", width=own)
    for row in cells:
        table.add_row(*(Text(row[name]) for name in names))
    return table


def _widths(cells: Sequence[dict[str, str]], names: Sequence[str], width: int) -> list[int]:
    """Widths of columns: each its longest word, and what is left over for those whose lines are longer."""
    widths = [max(1, _widest(cells, name, str.split)) for name in names]
    wishes = [max(1, _widest(cells, name, str.splitlines)) for name in names]
    left = width - sum(own + 3 for own in widths) - 1
    # The columns that need least first, so that what they leave goes to those of long texts.
    order = sorted(range(len(names)), key=lambda place: wishes[place] - widths[place])
    for number, place in enumerate(order):
        more = min(wishes[place] - widths[place], max(0, left) // (len(order) - number))
        widths[place] += more
        left -= more
    return widths
