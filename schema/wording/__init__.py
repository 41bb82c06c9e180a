"""Texts of questions, and the reverse conversion.

`render` converts a plan into English, and `parse` reads the text: `canonical(parse(render(t, p, key))[1])` is
`canonical(p)`. Both use the rows of `schema.templates`. The slots of a text have phrases from other tables: actions,
interactions and things (`schema.labels`, `schema.things`), people (`people`), and relations between two people
(`relations`).
"""
