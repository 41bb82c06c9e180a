"""The social layer: `labels_2d_activity_social_stitched/<sequence>.json` -> annotation tables.

The reasoning layer: `labels_2d_stitched_new_version/<sequence>.json` -> annotation tables.

These are social files with things besides.
"""

from __future__ import annotations

from pathlib import Path

from jrdb_avr.loaders.layers.layer import Reading
from jrdb_avr.loaders.layers.social import HandlingRecord, ReasoningRecord, SocialRecord, read_relations
from jrdb_avr.loaders.problems import Problems


def load_social(path: Path, sequence: str, problems: Problems) -> Reading:
    """Demographics, interactions and group information of a social file.

    A record without `H-interaction` (or `HHI`) leaves its interactions unknown; an empty list says that there are none.
    Raises InputError if the file as a whole cannot be used.
    """
    return read_relations(path, sequence, SocialRecord, False, problems)


def load_reasoning(path: Path, sequence: str, problems: Problems, social: bool) -> Reading:
    """What people do with things; with `social` also demographics, interactions and group information.

    A record without `HOI` or `HHI` (or `H-interaction`) has no such relation: in these files a missing list is an empty
    one. Raises InputError if the file as a whole cannot be used.
    """
    return read_relations(path, sequence, ReasoningRecord if social else HandlingRecord, True, problems)
