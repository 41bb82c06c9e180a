"""The social layer: `labels_2d_activity_social_stitched/<sequence>.json` -> annotation tables."""

from __future__ import annotations

from pathlib import Path

from .problems import Problems
from .reading import Reading
from .relations import SocialRecord, read_relations


def load_social(path: Path, sequence: str, problems: Problems) -> Reading:
    """Demographics, interactions and group information of a social file.

    A record without `H-interaction` (or `HHI`) leaves its interactions unknown; an empty list says that there are none.
    Raises InputError if the file as a whole cannot be used.
    """
    return read_relations(path, sequence, SocialRecord, False, problems)
