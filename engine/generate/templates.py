"""Plans of candidates as texts, made from columns."""

from __future__ import annotations

import re
from collections.abc import Mapping

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.plan import Condition, canonical
from jrdb_avr.schema.templates import Slots, Template


def plan_texts(template: Template, columns: Mapping[str, pa.Array]) -> pa.Array:
    """Canonical plans of candidates, set-wise.

    `columns` holds `conditions` (as JSON, without brackets), one column of frames per stated time, one of relations
    per hop, and `action` and `action2` where the template names them.
    """
    # The longer mark first: it begins like the shorter one.
    holes = {"?conditions": "conditions", "?action2": "action2", "?action": "action"}
    holes |= {f"?{name}": name for name in template.relations}
    stated = {name: 9_000_001 + i for i, name in enumerate(template.stated)}
    holes |= {str(mark): name for name, mark in stated.items()}
    skeleton = template.build(
        Slots(
            (Condition(action="?conditions", at="t0"),),
            stated,
            ("?action", "?action2")[: template.actions],
            tuple(f"?{name}" for name in template.relations),
        )
    )
    text = canonical(skeleton).replace('{"action":"?conditions","at":"t0"}', "?conditions")
    pieces = re.split("(" + "|".join(map(re.escape, holes)) + ")", text)
    return joined([columns[holes[piece]] if piece in holes else piece for piece in pieces])


def joined(pieces: list[pa.Array | str]) -> pa.Array:
    """Texts put together from columns and constants; numbers are written as they are."""
    # Without a type, Arrow looks for packages that know of dates, every time.
    parts = [
        pa.scalar(piece, pa.string()) if isinstance(piece, str) else pc.cast(piece, pa.string()) for piece in pieces
    ]
    return pc.binary_join_element_wise(*parts, pa.scalar("", pa.string()))
