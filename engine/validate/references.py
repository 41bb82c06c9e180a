"""Scores of the references that the tables of `report` have below the runs: chance and blind guessers."""

from __future__ import annotations

from jrdb_avr.engine.generate.blind import counting_guesser, question_texts, score_forms
from jrdb_avr.engine.report.truth import is_imported
from jrdb_avr.engine.validate.scene_guessers import box_guesser
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.references import Reference, make_references
from jrdb_avr.schema.tables import GENERATION_KEY


def read_references(store: Store) -> list[Reference]:
    """Score the references on the questions of a store, by the forms of templates.

    Args:
        store: The store.

    Returns:
        The references. The list is empty if `generate` did not write the questions, or if the store has no intervals.
    """
    generated = GENERATION_KEY.encode() in (store.questions("questions", []).schema.metadata or {})
    if not generated or is_imported(store) or not (store.path / "intervals").is_dir():
        return []
    texts = question_texts(*store.question_tables("questions", "answers"))
    references = make_references(any(is_of_sample(text.sequence) for text in texts))
    for group, scores in score_forms(texts, [counting_guesser(), box_guesser(store)]):
        for reference in references:
            reference.add([question.question_id for question in group], scores)
    return references
