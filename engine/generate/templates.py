"""What generation makes of a template's row: its query with the rules' values, and plans of candidates as columns.

A template's candidates come from `queries/generators/<form>.cypher`; each row names the description (`name`), the
moments of the people along the path (`at0` of a, then `b`, `c`, ...) with the relations between them (`r1`, ...), and
the moments (`at1`, ...) or segments it speaks of. What the perturbed programs answer comes from
`queries/necessity/*.cypher`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.plan import Condition, canonical
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.templates import Slots, Template


def query_text(folder: str, name: str) -> str:
    """The text of a packaged Cypher file."""
    return resources.files("jrdb_avr.queries").joinpath(folder, f"{name}.cypher").read_text(encoding="utf-8")


def query_values(rules: Rules) -> dict[str, int | float]:
    """Values of the parameters that the queries may use; frames, metres and degrees."""
    return {
        "wait": frames(rules.min_wait_s),
        "later": frames(rules.long_wait_s),
        "search": frames(rules.search_wait_s),
        "turn": rules.turn_deg,
        "gap": frames(rules.gap_min_s),
        "least": rules.count_min,
        "fps": FPS,
        "changed": rules.distance_changed_m,
        "same": rules.distance_same_m,
    }


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
