"""The reasoning layer: `labels_2d_stitched_new_version/<sequence>.json` -> annotation tables.

These are social files with things besides.
"""

from __future__ import annotations

from pathlib import Path

from .problems import Problems
from .reading import Reading
from .relations import HandlingRecord, ReasoningRecord, read_relations


def load_reasoning(path: Path, sequence: str, problems: Problems, social: bool) -> Reading:
    """What people do with things; with `social` also demographics, interactions and group information.

    A record without `HOI` or `HHI` (or `H-interaction`) has no such relation: in these files a missing list is an empty
    one. Raises InputError if the file as a whole cannot be used.
    """
    return read_relations(path, sequence, ReasoningRecord if social else HandlingRecord, True, problems)
