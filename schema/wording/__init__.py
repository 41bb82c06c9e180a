"""The words of the questions: one template table, and its exact inverse.

`render` writes a plan as plain English, `parse` reads such a text back: `canonical(parse(render(t, p, key))[1])` is
`canonical(p)`. Both work from the same table (`templates`, whose rows are explained in `rows`), so a new template is a
new row there. The phrases in its places are tables too: actions, interactions and things handled (`phrases`,
`things`), people (`people`) and relations between two of them (`relations`).
"""

from jrdb_avr.schema.wording.people import describe, in_order, read_description
from jrdb_avr.schema.wording.text import (
    actions_of,
    moment,
    parse,
    poses_of,
    question_id,
    question_key,
    render,
    stated_actions,
    stated_frames,
)

__all__ = [
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
