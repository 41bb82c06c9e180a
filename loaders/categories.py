"""The categories of a file in the COCO style: their numbers are the file's own, so they are known by name.

What a name stands for is told by `schema/things.py`; a name outside its vocabulary is kept as written and reported.
"""

from __future__ import annotations

from collections import Counter
from typing import Final

import msgspec
import pyarrow as pa

from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.things import OBJECTS, normal_category

from . import fields
from .coco import CocoFile, ListReader, Number, repaired_number
from .problems import Problems
from .records import record_parts

MAX_CATEGORY: Final = 2**31 - 2


class Category(msgspec.Struct, gc=False):
    """One entry of the file's list of categories."""

    id: Number
    name: str


Categories = dict[int, tuple[str, str | None]]
"""For each number of the file's: the name as written, and its usual name, None outside the vocabulary."""


def read_categories(file: CocoFile, problems: Problems) -> tuple[Categories, Counter[tuple[str, str]]]:
    """The list of categories, and names outside the vocabulary. Without a list every category is unknown."""
    names: Categories = {}
    ambiguous: set[int] = set()
    begin, _ = file.spans.get("categories", (len(file.data), 0))
    if file.data[begin : begin + 1] != b"[":
        problems.add("file", "there is no list of categories: what things are is unknown", field="categories")
        return names, Counter()
    for chunk in _CATEGORIES.read(file, "categories", problems):
        for category in chunk:
            try:
                raw = fields.text(category.name)
                if not 0 <= category.id <= MAX_CATEGORY:
                    raise ValueError("number out of range")
            except ValueError as error:
                problems.add("record", str(error), field="categories", value=(category.id, category.name))
                continue
            usual = normal_category(raw)
            name = usual if usual in OBJECTS else None
            if category.id not in names:
                names[category.id] = (raw, name)
            elif normal_category(names[category.id][0]) == usual:
                problems.add("record", "category twice, the first is kept", field="categories", value=raw)
            else:
                # Nobody can tell which of the two its annotations are of.
                ambiguous.add(category.id)
                problems.add("record", "category number of two names, neither is kept", field="categories", value=raw)
    kept = {number: names[number] for number in sorted(names) if number not in ambiguous}
    return kept, Counter(("categories", normal_category(raw)) for raw, name in kept.values() if name is None)


def categories_table(sequence: str, categories: Categories) -> pa.Table:
    """The annotation table `categories`, by number."""
    rows = [
        {"sequence": sequence, "category_id": number, "category": name, "raw": raw}
        for number, (raw, name) in categories.items()
    ]
    return pa.Table.from_pylist(rows, ANNOTATIONS["categories"])


def _repair_category(raw: bytes, frame: str, problems: Problems) -> Category | None:
    parts = record_parts(raw, frame, problems)
    number = None if parts is None else repaired_number(parts, "id", "", problems, "categories.id")
    if parts is None or number is None:
        return None
    try:
        return Category(number, fields.text(fields.loose(parts.get("name", b"null"))))
    except ValueError as error:
        problems.add("record", f"name: {error}", field="categories.name", value=parts.get("name", b"missing"))
        return None


_CATEGORIES: Final = ListReader(Category, _repair_category, ("id", "name"))
