"""The words of the questions: one template table, and its exact inverse.

`render` writes a plan as plain English, `parse` reads such a text back: `canonical(parse(render(t, p, key))[1])` is
`canonical(p)`. Both work from the same table (`templates`, whose rows are explained in `rows`), so a new template is a
new row there. The phrases in its places are tables too: actions, interactions and things handled (`phrases`,
`things`), people (`people`) and relations between two of them (`relations`).
"""

from .identity import actions_of, poses_of, question_id, question_key, stated_actions, stated_frames
from .people import describe, in_order, read_description
from .phrases import ACTION_PHRASES, INTERACTION_PHRASES
from .relations import RELATIONS, RELATIONS_OF
from .rows import Slots, Template
from .templates import FAMILIES, TEMPLATES
from .text import moment, parse, render

__all__ = [
    "ACTION_PHRASES",
    "FAMILIES",
    "INTERACTION_PHRASES",
    "RELATIONS",
    "RELATIONS_OF",
    "TEMPLATES",
    "Slots",
    "Template",
    "actions_of",
    "describe",
    "in_order",
    "moment",
    "parse",
    "poses_of",
    "question_id",
    "question_key",
    "read_description",
    "render",
    "stated_actions",
    "stated_frames",
]
