"""Layout of rows as text tables that fit into a given width. Words and numbers are not split.

Long cells wrap between words. A table that is still too wide is transposed if it has only one row, or if it has few
rows and the transposed table fits. Any other table that is still too wide is divided: its columns are distributed over
several tables.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rich.table import Table

_Cells = Sequence[Mapping[str, str]]

_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")

_HIDDEN: Final = re.compile(
    r"[\xad\u034f\u061c\u180e\u200b-\u200f\u202a-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\U000e0000-\U000e007f]"
)
"""Characters that reorder text or have no width, so that a text may look like another text."""

_LONG: Final = re.compile(r"\S{41,}")

_LONGEST: Final = 20_000
"""Maximum number of characters of a cell. The layout of a longer text would take minutes."""

_MAX_TRANSPOSED: Final = 3
"""Maximum number of rows of a table that is transposed."""

_MAX_KEYS: Final = 3
"""Maximum number of key columns of a divided table. Each part of the table repeats the key columns."""

_ENGINE_FIELDS: Final = ("_ID", "_SRC", "_DST", "_LABEL")
"""Fields that the graph engine adds to nodes and relations. They are not printed."""


def clean(value: object) -> str:
    """Return a value as text without control characters. Hidden characters are replaced by their codes.

    Args:
        value: Any value. None becomes an empty text.

    Returns:
        The text. A terminal can print this text safely: the text cannot move the cursor or change the colours.
    """
    text = _CONTROL.sub("", "" if value is None else str(value))
    return _HIDDEN.sub(lambda match: f"[U+{ord(match[0]):04X}]", text)


def cell_text(value: object) -> str:
    """Return a value as the text of a table cell.

    Args:
        value: A value of a row.

    Returns:
        The text. A float has six significant digits. Nodes, relations and paths of the graph are written as in Cypher.

    >>> cell_text({"_ID": 0, "_LABEL": "Person", "track": 3, "age": None})
    '(:Person {track: 3})'
    """
    if isinstance(value, float):
        return f"{value:.0f}" if 1e6 <= abs(value) < 1e15 else f"{value:.6g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(cell_text, value))}]"
    if isinstance(value, dict):
        return _graph_text(value)
    # A word of more than 40 characters is JSON or a list of names. Spaces after commas let the word wrap.
    text = clean(value)
    rest = f"... ({len(text)} characters: --json prints all)" if len(text) > _LONGEST else ""
    return _LONG.sub(lambda match: match[0].replace(",", ", "), text[:_LONGEST]) + rest


def _graph_text(value: dict[str, Any]) -> str:
    if value.keys() == {"_NODES", "_RELS"}:
        return _path_text(value["_NODES"] or [], value["_RELS"] or [])
    hidden = _ENGINE_FIELDS if "_LABEL" in value else ()
    parts = [
        f"{clean(name)}: {cell_text(item)}" for name, item in value.items() if not (name in hidden or item is None)
    ]
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


def make_tables(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], width: int) -> list[Table]:
    """Lay rows out as tables.

    Args:
        rows: The rows.
        columns: Names of the columns. If there are no names, all keys of the rows become columns.
        width: Maximum characters per line. Because words are not split, very long words may make a line longer.

    Returns:
        One `rich` table, or several tables to print below each other.
    """
    names = list(columns or dict.fromkeys(name for row in rows for name in row))
    numbers = {name for name in names if _is_numeric(row.get(name) for row in rows)}
    cells = [{name: cell_text(row.get(name)) for name in names} for row in rows]
    if _min_width(names, cells) <= width:
        return [_make_table(names, cells, numbers, width)]
    heads = [names[0], *(row[names[0]] for row in cells)]
    if 0 < len(cells) <= _MAX_TRANSPOSED and len(set(heads)) == len(heads):
        lines = [dict(zip(heads, [name, *(row[name] for row in cells)], strict=True)) for name in names[1:]]
        if len(cells) == 1 or _min_width(heads, lines) <= width:
            return [_make_table(heads, lines, set(), width)]
    return [_make_table(part, cells, numbers, width) for part in _split_columns(names, cells, width)]


def _split_columns(names: Sequence[str], cells: _Cells, width: int) -> list[list[str]]:
    """Divide the columns into parts, one for each table. Each part fits the width, if possible.

    Each part begins with the columns that identify a row, if there is space for them.
    """
    key = list(names[:1])
    for count in range(_MAX_KEYS, 0, -1):
        if len({tuple(row[name] for name in names[:count]) for row in cells}) == len(cells):
            key = list(names[:count])
    widest = max(_min_width([name], cells) for name in names)
    while key and _min_width(key, cells) + widest > width:
        key.pop()
    parts = [[*key]]
    for name in names[len(key) :]:
        if len(parts[-1]) > len(key) and _min_width([*parts[-1], name], cells) > width:
            parts.append([*key])
        parts[-1].append(name)
    return parts


def _min_width(names: Sequence[str], cells: _Cells) -> int:
    """Return the width, in characters with the borders, of the narrowest table that splits no word."""
    return sum(_max_length(str.split, name, cells) + 3 for name in names) + 1


def _max_length(split: Any, name: str, cells: _Cells) -> int:
    from rich.cells import cell_len

    texts = [clean(name), *(row[name] for row in cells)]
    return max((cell_len(part) for text in texts for part in split(text)), default=0)


def _is_numeric(values: Iterable[object]) -> bool:
    present = [value for value in values if value is not None]
    return bool(present) and all(isinstance(value, int | float) for value in present)


def _make_table(names: Sequence[str], cells: _Cells, numbers: set[str], width: int) -> Table:
    from rich.table import Table
    from rich.text import Text

    # Widths are set here, because rich may shrink a column below its longest word.
    # The columns that need the least additional width grow first.
    widths = {name: max(1, _max_length(str.split, name, cells)) for name in names}
    lacks = {name: _max_length(str.splitlines, name, cells) - widths[name] for name in names}
    spare = max(0, width - sum(widths.values()) - 3 * len(names) - 1)
    for index, name in enumerate(sorted(names, key=lacks.__getitem__)):
        more = max(0, min(lacks[name], spare // (len(names) - index)))
        widths[name] += more
        spare -= more
    table = Table()
    for name in names:
        table.add_column(Text(clean(name)), justify="right" if name in numbers else "left", width=widths[name])
    for row in cells:
        table.add_row(*(Text(row[name]) for name in names))
    return table
