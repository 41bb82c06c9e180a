"""What the label records of every layer share: the person they are of, and repair of records that are not clean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from jrdb_avr.schema.arrays import Ints

from . import fields
from .jsonscan import MalformedError, members
from .problems import Problems, shorten

OTHER: Final = -1
BAD: Final = -2


def track_codes(labels: Sequence[str], code: Ints) -> Ints:
    """Track per row of numbered label ids; OTHER for what is no tracked person, BAD for no label id at all."""
    found = np.array([_track_or_code(label) for label in labels], np.int64)
    return found[code] if len(found) else code


def _track_or_code(label: str) -> int:
    try:
        return fields.track_of(label)
    except fields.NotAPersonError:
        return OTHER
    except ValueError:
        return BAD


def record_parts(raw: bytes, frame: str, problems: Problems) -> dict[str, bytes] | None:
    """Raw values of a record by key, first of equal keys; None, with the reason counted, if it is no object."""
    parts: dict[str, bytes] = {}
    try:
        for key, begin, end in members(raw):
            name = fields.loose(key)
            if name in parts:
                problems.add("field", "key twice, the first is kept", frame=frame, field=shorten(name))
            else:
                parts[name] = raw[begin:end]
    except (MalformedError, ValueError):
        problems.add("record", "record is no object", frame=frame, value=raw)
        return None
    return parts


def repaired_label(parts: dict[str, bytes], frame: str, problems: Problems) -> str | None:
    """The record's label id, whether of a person or not; None, with the reason counted, if it has none."""
    raw = parts.get("label_id", b"null")
    try:
        label = fields.loose(raw)
        fields.track_of(label)
    except fields.NotAPersonError:
        pass  # skipped by column, with the others of its kind
    except ValueError as error:
        problems.add("record", str(error), frame=frame, field="label_id", value=raw)
        return None
    return str(label)


def repaired_box(
    parts: dict[str, bytes], frame: str, problems: Problems, kind: str = "record"
) -> tuple[float, float, float, float] | None:
    """The record's 2D box, four numbers; None, with the reason counted, if it has none. `kind`: what is lost then."""
    try:
        box = fields.loose(parts.get("box", b"null"))
        if not isinstance(box, list) or len(box) != 4:
            raise ValueError("not four numbers")
        x, y, w, h = (fields.number(value) for value in box)
    except ValueError as error:
        problems.add(kind, f"box: {error}", frame=frame, field="box", value=parts.get("box", b"missing"))
        return None
    return x, y, w, h


def unpacked(raw: bytes, field: str, frame: str, problems: Problems) -> dict[str, Any]:
    """Members of a sub-object, first of equal keys, repeated ones counted. Raises ValueError if it is no object."""
    items, again = fields.pairs(raw)
    for name in again:
        problems.add("field", "key twice, the first is kept", frame=frame, field=f"{field}.{shorten(name)}")
    return dict(items)
