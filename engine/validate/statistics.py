"""Statistics of a benchmark: counts, distributions, reasons for few questions of a template, and blind baselines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any, Final, NamedTuple

import numpy as np

from jrdb_avr.engine.generate.blind import Guesser, QuestionText, blind_check, question_texts
from jrdb_avr.engine.generate.diagnostics import REFUSALS, shortfalls, tallies
from jrdb_avr.engine.generate.selection import PROFILES
from jrdb_avr.engine.generate.views import min_crops
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.panorama import angle_error, center_angle
from jrdb_avr.schema.questions import QuestionRecord
from jrdb_avr.schema.tables import LAYERS
from jrdb_avr.schema.templates import FAMILIES, FORMS, forms_of

TITLES: Final = {
    "family": "Questions per family, beside the paper's",
    "template": "Questions per template and kind of answer",
    "mode": "Questions per answer mode",
    "sequence": "Questions per sequence",
    "shortfall": "From candidates to questions",
    "refusal": "Candidates refused, by rule",
    "lacking": "Templates that lack a layer",
    "layer": "Sequences that have a layer",
    "answer": "Answers per template (of times: offset from the description, or length, in seconds)",
    "position": "Position of the true choice",
    "distractor": "What yields the wrong choices",
    "distribution": "Waits, turns, hops, words, people and looks",
    "spread": "The same per template (smallest, median, mean, largest)",
    "blind": "Answering without looking: shares of right answers",
}
"""The tables of `stats`, in the order in which they are printed."""

MEASURES: Final = {
    "time_gap_s": (0.0, 0.001, 5.0, 10.0, 20.0, 40.0, 80.0),
    "separation_deg": (0.0, 10.0, 20.0, 45.0, 90.0, 135.0),
    "apart_deg": (0.0, 10.0, 20.0, 45.0, 90.0, 135.0),
    "hops": tuple(float(edge) for edge in range(4)),
    "words": (0.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0),
    "people_in_scene": (0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0),
    "crops": (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0),
}
"""The measures of each question, with the lower edges of their bins; the last bin has no end.

time_gap_s: seconds from the description to the last time that the question is about; separation_deg: the angle at the
robot between the target at the description and at its decisive boxes; apart_deg: the largest angle between any two
needed boxes, at whatever times; hops: relations that lead one after another to the target (`Template.hops`); words: of
the question's text; people_in_scene: people with a box at that time; crops: the fewest looks that show every needed box
(`views.min_crops`)."""


_Row = dict[str, Any]


class MeasuredQuestion(NamedTuple):
    """A question with the facts that its text states and its MEASURES."""

    record: QuestionRecord
    text: QuestionText
    measures: Mapping[str, float]


def statistics(store: Store, learned: Guesser | None = None) -> dict[str, list[_Row]]:
    """Rows of every table in TITLES; `learned` joins the blind check. Raises StoreError without questions."""
    questions, answers, rejected = store.question_tables("questions", "answers", "rejected")
    rows = zip(*(table.sort_by("question_id").to_pylist() for table in (questions, answers)), strict=True)
    measured = [
        _measured(QuestionRecord.read(*row), text)
        for row, text in zip(rows, question_texts(questions, answers), strict=True)
    ]
    layers = {name: entry.layers for name, entry in store.manifest().sequences.items()}
    lacking, refused = _lacking(layers), tallies(rejected, questions)
    counts = {(row["template"], row["layer"]): row["sequences_without"] for row in lacking}
    unclear = _without_occlusion(store)
    records, total = [one.record for one in measured], max(1, len(measured))
    families, sequences = (Counter(getattr(record, name) for record in records) for name in ("family", "sequence"))
    people = Counter(sequence for sequence, _ in {(record.sequence, record.target_track) for record in records})
    having = Counter(layer for own in layers.values() for layer in own)
    return {
        "family": [
            {
                "family": name,
                "n": families[name],
                "share": families[name] / total,
                "paper": paper,
                **_length(measured, name),
            }
            for name, paper in PROFILES["paper"].items()
        ],
        "template": _counted(
            {"family": record.family, "template": record.template, "asks": text.asks, "mode": record.answer_mode}
            for record, text, _ in measured
        ),
        "mode": _counted({"mode": record.answer_mode} for record in records),
        "sequence": [
            {
                "sequence": name,
                "n": sequences[name],
                "share": sequences[name] / total,
                "people": people[name],
                "occlusion": None if unclear is None else name not in unclear,
            }
            for name in sorted(layers)
        ],
        "shortfall": shortfalls(refused, counts, len(layers)),
        "refusal": [
            {"family": row["family"], "template": row["template"], "rule": rule, "candidates": row[rule]}
            for row in sorted(refused, key=lambda row: (row["family"], row["template"]))
            for rule in sorted(REFUSALS)
            if row[rule]
        ],
        "lacking": lacking,
        "layer": [{"layer": name, "sequences_with": having[name], "sequences": len(layers)} for name in LAYERS],
        "answer": _answers(measured),
        "position": _positions(measured),
        "distractor": _distractors(measured),
        "distribution": _distributions(measured),
        "spread": _spread(measured),
        "blind": [
            {"family": FAMILIES[row["template"]], **row} for row in blind_check([one.text for one in measured], learned)
        ],
    }


def generator_rows(tables: Mapping[str, Sequence[_Row]]) -> list[_Row]:
    """The paper's table of generators, from the tables of `statistics`: one row per family."""

    def named(family: str, column: str) -> str:
        names = dict.fromkeys(row[column] for row in tables["template"] if row["family"] == family)
        return ", ".join(names).replace("_", " ")

    return [
        {
            "generator": row["family"].replace("_", " ").replace("hop", "-hop"),
            "questions": row["n"],
            "templates": named(row["family"], "template"),
            "answer mode": named(row["family"], "mode"),
            "hops": row["hops"],
            "words": row["words"],
        }
        for row in tables["family"]
    ]


def _length(measured: Sequence[MeasuredQuestion], family: str) -> _Row:
    """The hops that occur in a family, and the mean number of words."""
    own = [one.measures for one in measured if one.record.family == family]
    hops = ", ".join(f"{number:g}" for number in sorted({measures["hops"] for measures in own}))
    return {"hops": hops or None, "words": sum(measures["words"] for measures in own) / len(own) if own else None}


def _without_occlusion(store: Store) -> list[str] | None:
    """The sequences without occlusion attributes; None where the intervals that tell are gone: questions do not need
    them."""
    try:
        return store.without_occlusion()
    except StoreError:
        return None


def _measured(record: QuestionRecord, text: QuestionText) -> MeasuredQuestion:
    measures = {name: float(getattr(record, name)) for name in MEASURES if hasattr(record, name)}
    measures |= {"hops": float(forms_of(record.template)[0].hops), "words": float(len(record.question.split()))}
    angles = np.array([center_angle(box.x, box.w) for box in record.needed])
    measures["apart_deg"] = float(angle_error(angles[:, None], angles).max())
    measures["crops"] = float(min_crops((box.frame, box.x, box.w) for box in record.needed))
    return MeasuredQuestion(record, text, measures)


def _counted(rows: Iterable[dict[str, Any]], within: Sequence[str] = ()) -> list[_Row]:
    """Distinct rows with their n and their share of all, or of all rows that agree in the columns of `within`."""
    counts = Counter(tuple(row.items()) for row in rows)
    counted = [dict(key) | {"n": n} for key, n in sorted(counts.items())]
    totals: Counter[tuple[Any, ...]] = Counter()
    for row in counted:
        totals[tuple(row[name] for name in within)] += row["n"]
    return [row | {"share": row["n"] / totals[tuple(row[name] for name in within)]} for row in counted]


def _answers(measured: Sequence[MeasuredQuestion]) -> list[_Row]:
    """Texts of choices by name, bins of times in their order."""
    rows = []
    for record, text, _ in measured:
        choice = record.answer_mode == "multiple_choice"
        name = record.answer_text if choice else text.bin
        place = 0.0 if choice else float(name.strip("[").split(",")[0])
        rows.append({"template": record.template, "asks": text.asks, "place": place, "answer": name})
    counted = _counted(rows, within=("template", "asks"))
    return [{name: value for name, value in row.items() if name != "place"} for row in counted]


def _positions(measured: Sequence[MeasuredQuestion]) -> list[_Row]:
    return _counted(
        (
            {"template": record.template, "position": text.answer.choice}
            for record, text, _ in measured
            if isinstance(text.answer, Choice)
        ),
        within=("template",),
    )


def _distractors(measured: Sequence[MeasuredQuestion]) -> list[_Row]:
    """Wrong choices by the perturbation that yields them; "none" are answers known false that no perturbation yields.

    "look-alike without action sitting" and its like count as one.
    """
    return _counted(
        (
            {"template": record.template, "yielded_by": (name or "none").split(" without ")[0]}
            for record, text, _ in measured
            for position, name in enumerate(record.distractors, start=1)
            if isinstance(text.answer, Choice) and position != text.answer.choice
        ),
        within=("template",),
    )


def _distributions(measured: Sequence[MeasuredQuestion]) -> list[_Row]:
    """Every bin of every measure, also the empty ones."""
    rows = []
    for name, edges in MEASURES.items():
        values = np.array([one.measures[name] for one in measured], float)
        counts = np.bincount(np.searchsorted(edges, values, side="right") - 1, minlength=len(edges))
        for number, n in enumerate(counts.tolist()):
            bin_name = _bin_name(name, edges, number)
            rows.append({"what": name, "bin": bin_name, "n": n, "share": n / max(1, len(measured))})
    return rows


def _bin_name(what: str, edges: Sequence[float], number: int) -> str:
    """ "3" or "6-7" for counts, else "[20, 40)"; the last is "12+"."""
    low = edges[number]
    if number + 1 == len(edges):
        return f"{low:g}+"
    high = edges[number + 1]
    if what == "time_gap_s" and number < 2:
        return ("0", f"(0, {high:g})")[number]
    if what in ("time_gap_s", "separation_deg", "apart_deg"):
        return f"[{low:g}, {high:g})"
    return f"{low:g}" if high == low + 1 else f"{low:g}-{high - 1:g}"


def _spread(measured: Sequence[MeasuredQuestion]) -> list[_Row]:
    rows = []
    for template in sorted({one.record.template for one in measured}):
        for name in MEASURES:
            values = [one.measures[name] for one in measured if one.record.template == template]
            numbers = {"n": len(values), "min": min(values), "median": float(median(values))}
            numbers |= {"mean": sum(values) / len(values), "max": max(values)}
            rows.append({"template": template, "what": name, **numbers})
    return rows


def _lacking(layers: Mapping[str, Sequence[str]]) -> list[_Row]:
    """Templates that some sequences cannot carry, with the layer and how many sequences lack it."""
    rows = []
    for name, forms in FORMS.items():
        # A template needs only the layers of its least demanding form.
        for layer in min((form.layers for form in forms), key=len):
            without = sum(layer not in present for present in layers.values())
            if without:
                row = {"family": forms[0].family, "template": name, "layer": layer}
                rows.append(row | {"sequences_without": without, "sequences": len(layers)})
    return rows
