"""The words of the questions, and their exact inverse.

`render` writes a plan as plain English, `parse` reads such a text back: `canonical(parse(render(t, p, key))[1])` is
`canonical(p)`. Both work from the rows of `schema.templates`. The phrases
in their slots are tables too: of actions, interactions and things (`schema.labels`, `schema.things`), of people
(`people`) and of relations between two people (`relations`).
"""
