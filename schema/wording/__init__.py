"""The words of the questions, and their exact inverse.

`render` writes a plan as plain English, `parse` reads such a text back: `canonical(parse(render(t, p, key))[1])` is
`canonical(p)`. Both work from the rows of `schema.templates`. The phrases
in their slots are tables too: of actions, interactions and things (`schema.labels`, `schema.things`), of people
(`people`) and of relations between two people (`relations`).
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
