"""Statistics of a benchmark: counts, distributions, reasons for a shortage of questions, and blind baselines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.blind import QuestionText, question_texts
from jrdb_avr.engine.generate.diagnostics import tallies
from jrdb_avr.engine.generate.selection import PROFILES
from jrdb_avr.engine.observe.crops import min_crops
from jrdb_avr.engine.report.truth import refuse_imported
from jrdb_avr.engine.validate.scene_guessers import check_store
from jrdb_avr.queries.sql import open_tables
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.labels import answer_of_choice
from jrdb_avr.schema.panorama import angle_error, center_angle
from jrdb_avr.schema.questions import QuestionRecord
from jrdb_avr.schema.tables import LAYERS
from jrdb_avr.schema.templates import forms_of

TITLES: Final = {
    "family": "Questions per family, beside the paper's",
    "template": "Questions per template and kind of answer",
    "mode": "Questions per answer mode",
    "sequence": "Questions per sequence",
    "shortfall": "From candidates to questions",
    "layer": "Sequences that have a layer",
    "answer": "Answers per template (of times: offset from the description, or length, in seconds)",
    "position": "Position of the true choice",
    "distribution": "Waits, turns, hops, words, people and looks",
    "spread": "The same per template (smallest, median, mean, largest)",
    "blind": "Answering without looking: shares of right answers",
}
"""Titles of the tables of `stats` by name, in the order of the output."""

_MEASURED: Final = pa.schema(
    [(name, pa.string()) for name in ("question_id", "sequence", "family", "template", "answer_mode", "asks", "answer")]
    + [("target_track", pa.int32()), ("position", pa.int32()), ("choices", pa.list_(pa.string()))]
    + [(name, pa.float64()) for name in ("time_gap_s", "separation_deg", "apart_deg", "hops", "words")]
    + [(name, pa.float64()) for name in ("people_in_scene", "crops")]
)
"""Columns of the table that the statements of `queries/stats/` count. It has a row per question.

- answer: text of the true choice, or the bin of another answer.
- position: number of the true choice, from 1.
- choices: answers of all choices.
- time_gap_s: seconds from the description to the last time that the question is about.
- separation_deg: angle at the robot between the target at the description and the target's decisive boxes.
- apart_deg: largest angle between two needed boxes, at any times.
- hops: number of relations on the path to the target (`Template.hops`).
- words: number of words in the text of the question.
- people_in_scene: number of people with a box at the time of the description.
- crops: smallest number of looks that show all needed boxes (`crops.min_crops`).
"""

_SHORTFALL: Final = ("family", "template", "candidates", "proven", "questions", "why")

_Row = dict[str, Any]


def statistics(store: Store, blind_from: Store | None = None) -> dict[str, list[_Row]]:
    """Compute the statistics of a store.

    Args:
        store: The store.
        blind_from: Another store. A guesser of the blind check learns from its questions.

    Returns:
        The rows of each table in `TITLES`.

    Raises:
        StoreError: If the store has no questions or no intervals.
        InputError: If nothing can be learned from the other store.
    """
    refuse_imported(store, "count them with 'jrdb-avr sql'")
    questions, answers, rejected = store.question_tables("questions", "answers", "rejected")
    store.warn_of_training()
    rows = zip(*(table.sort_by("question_id").to_pylist() for table in (questions, answers)), strict=True)
    texts = question_texts(questions, answers)
    measured = [_measured(QuestionRecord.read(*row), text) for row, text in zip(rows, texts, strict=True)]
    layers = {name: entry.layers for name, entry in store.manifest().sequences.items()}
    present = Counter(name for own_layers in layers.values() for name in own_layers)
    counted = tallies(rejected, questions, layers)
    evidence = store.visibility()
    visibility = pa.array([evidence.get(name) for name in layers], pa.string())
    paper = PROFILES["paper"]
    tables = {
        "measured": pa.Table.from_pylist(measured, _MEASURED),
        "families": pa.table({"family": list(paper), "paper": list(paper.values())}),
        "loaded": pa.table({"sequence": pa.array(layers, pa.string()), "visibility": visibility}),
    }
    derived = {
        "shortfall": [{name: row[name] for name in _SHORTFALL} for row in counted],
        "layer": [{"layer": name, "sequences_with": present[name], "sequences": len(layers)} for name in LAYERS],
        "blind": check_store(store, texts, blind_from),
    }
    with open_tables(store.path, tables) as select:
        selected = {name: select(read_statement(f"stats/{name}.sql")) for name in TITLES if name not in derived}
    return {name: derived[name] if name in derived else selected[name].to_pylist() for name in TITLES}


def generator_rows(tables: Mapping[str, Sequence[_Row]]) -> list[_Row]:
    """Return the table of generators that the paper has.

    Args:
        tables: Tables of `statistics`.

    Returns:
        A row per family.
    """

    def join_names(family: str, column: str) -> str:
        names = dict.fromkeys(row[column] for row in tables["template"] if row["family"] == family)
        return ", ".join(names).replace("_", " ")

    return [
        {
            "generator": row["family"].replace("_", " ").replace("hop", "-hop"),
            "questions": row["n"],
            "templates": join_names(row["family"], "template"),
            "answer mode": join_names(row["family"], "mode"),
            "hops": row["hops"],
            "words": row["words"],
        }
        for row in tables["family"]
    ]


def _measured(record: QuestionRecord, text: QuestionText) -> _Row:
    position = text.answer.choice if isinstance(text.answer, Choice) else None
    angles = np.array([center_angle(box.x, box.w) for box in record.needed])
    return msgspec.structs.asdict(record) | {
        "asks": text.asks,
        "answer": text.bin if position is None else record.answer_text,
        "position": position,
        "choices": [answer_of_choice(choice) for choice in record.choices],
        "apart_deg": float(angle_error(angles[:, None], angles).max()),
        "hops": forms_of(record.template)[0].hops,
        "words": len(record.question.split()),
        "crops": min_crops((box.frame, box.x, box.w) for box in record.needed),
    }
