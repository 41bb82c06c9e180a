"""What the loader of one layer makes of one sequence's file."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import pyarrow as pa

from jrdb_avr.schema.arrays import Ints


@dataclass(frozen=True)
class Reading:
    """Annotation tables, the frames that each layer knows, and labels outside the vocabulary."""

    tables: dict[str, pa.Table]
    frames: dict[str, tuple[Ints, Ints]]
    """Per layer of the `frames` table: its frames, ascending, and the records in each."""
    unknown: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Count per (field, label)."""
    boxes: pa.Table | None = None
    """Columns frame, track, x, y, w, h: the file's own 2D boxes, where they are not its facts. They tell whether its
    frame numbers agree with those of the 2D layer."""
