"""What a benchmark holds: counts, distributions, why there are few of a kind, and how well it can be answered blind."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.engine.generate.blind import QuestionText, blind_check, question_texts
from jrdb_avr.engine.generate.diagnostics import shortfalls, tallies
from jrdb_avr.engine.generate.selection import PROFILES
from jrdb_avr.engine.generate.views import min_crops
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.panorama import angle_error, center_angle
from jrdb_avr.schema.tables import LAYERS
from jrdb_avr.schema.templates import FAMILIES, FORMS

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
    "distribution": "Waits, turns, steps, people and looks",
    "spread": "The same per template (smallest, median, mean, largest)",
    "blind": "Answering without looking: shares of right answers",
}
"""The tables of `stats`, in the order in which they are printed."""

MEASURES: Final = {
    "time_gap_s": (0.0, 0.001, 5.0, 10.0, 20.0, 40.0, 80.0),
    "separation_deg": (0.0, 10.0, 20.0, 45.0, 90.0, 135.0),
    "apart_deg": (0.0, 10.0, 20.0, 45.0, 90.0, 135.0),
    "hops": tuple(float(edge) for edge in range(5)),
    "people_in_scene": (0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0),
    "crops": (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0),
}
"""What is measured of each question, with the lower edges of the bins in which it is counted; the last has no end.

time_gap_s: seconds from the description to the last time asked about; separation_deg: how far the person asked
about turns from the description to what decides, as the robot sees it; apart_deg: the largest turn between any two
needed boxes, at whatever times; hops: relations to go by; people_in_scene: people with a box at the description's time;
crops: the fewest looks that show every needed box (`views.min_crops`)."""


class _Needed(msgspec.Struct):
    frame: int
    x: float
    w: float


@dataclass(frozen=True)
class Asked:
    """A question with its private side and what is measured of it."""

    posed: QuestionText
    family: str
    target: int
    distractors: tuple[str | None, ...]
    measures: Mapping[str, float]


def statistics(store: Store) -> dict[str, list[dict[str, Any]]]:
    """Rows of every table in TITLES. Raises StoreError where there are no questions."""
    questions, answers, rejected = (store.questions(name) for name in ("questions", "answers", "rejected"))
    private = answers.sort_by("question_id").to_pylist()
    asked = [_asked(one, own) for one, own in zip(question_texts(questions, answers), private, strict=True)]
    sequences = store.manifest().sequences
    lacking = _lacking({name: entry.layers for name, entry in sequences.items()})
    counts = {(row["template"], row["layer"]): row["sequences_without"] for row in lacking}
    return {
        "family": _families(asked),
        "template": _counted(
            {"family": one.family, "template": one.posed.template, "asks": one.posed.asks, "mode": one.posed.mode}
            for one in asked
        ),
        "mode": _counted({"mode": one.posed.mode} for one in asked),
        "sequence": _sequences(asked, sequences),
        "shortfall": shortfalls(tallies(rejected, questions), counts, len(sequences)),
        "refusal": _refusals(rejected.to_pylist()),
        "lacking": lacking,
        "layer": _layers([entry.layers for entry in sequences.values()]),
        "answer": _answers(asked),
        "position": _positions(asked),
        "distractor": _distractors(asked),
        "distribution": _distributions(asked),
        "spread": _spread(asked),
        "blind": [{"family": FAMILIES[row["template"]], **row} for row in blind_check([one.posed for one in asked])],
    }


def _asked(question: QuestionText, own: Mapping[str, Any]) -> Asked:
    needed = msgspec.json.decode(own["needed"], type=list[_Needed])
    measures = {name: float(own[name]) for name in MEASURES if name in own}
    angles = np.array([center_angle(box.x, box.w) for box in needed])
    measures["apart_deg"] = float(angle_error(angles[:, None], angles).max())
    measures["crops"] = float(min_crops((box.frame, box.x, box.w) for box in needed))
    return Asked(
        posed=question,
        family=FAMILIES[question.template],
        target=own["target_track"],
        distractors=tuple(msgspec.json.decode(own["distractors"], type=list[str | None])),
        measures=measures,
    )


def _counted(rows: Iterable[dict[str, Any]], within: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Distinct rows with their n and their share of all, or of all rows that agree in the columns of `within`."""
    counts: Counter[tuple[tuple[str, Any], ...]] = Counter(tuple(row.items()) for row in rows)
    totals: Counter[tuple[Any, ...]] = Counter()
    for key, n in counts.items():
        totals[tuple(dict(key)[name] for name in within)] += n
    return [
        dict(key) | {"n": n, "share": n / totals[tuple(dict(key)[name] for name in within)]}
        for key, n in sorted(counts.items())
    ]


def _families(asked: Sequence[Asked]) -> list[dict[str, Any]]:
    """Every family, in the paper's order."""
    counts = Counter(one.family for one in asked)
    return [
        {"family": family, "n": counts[family], "share": counts[family] / max(1, len(asked)), "paper": paper}
        for family, paper in PROFILES["paper"].items()
    ]


def _sequences(asked: Sequence[Asked], sequences: Iterable[str]) -> list[dict[str, Any]]:
    """Every sequence of the store, also those without a question."""
    counts = Counter(one.posed.sequence for one in asked)
    people = Counter(sequence for sequence, _ in {(one.posed.sequence, one.target) for one in asked})
    return [
        {"sequence": name, "n": counts[name], "share": counts[name] / max(1, len(asked)), "people": people[name]}
        for name in sorted(sequences)
    ]


def _answers(asked: Sequence[Asked]) -> list[dict[str, Any]]:
    """Texts of choices by name, bins of times in their order."""
    counts: Counter[tuple[str, str, float, str]] = Counter()
    for one in asked:
        question = one.posed
        if isinstance(question.answer, Choice):
            place, name = 0.0, question.choices[question.answer.choice - 1]
        else:
            name = question.bin
            place = float(name.strip("[").split(",")[0])
        counts[question.template, question.asks, place, name] += 1
    totals: Counter[tuple[str, str]] = Counter()
    for (template, asks, _, _), n in counts.items():
        totals[template, asks] += n
    return [
        {"template": template, "asks": asks, "answer": name, "n": n, "share": n / totals[template, asks]}
        for (template, asks, _, name), n in sorted(counts.items())
    ]


def _positions(asked: Sequence[Asked]) -> list[dict[str, Any]]:
    return _counted(
        (
            {"template": one.posed.template, "position": one.posed.answer.choice}
            for one in asked
            if isinstance(one.posed.answer, Choice)
        ),
        within=("template",),
    )


def _distractors(asked: Sequence[Asked]) -> list[dict[str, Any]]:
    """Wrong choices by the perturbation that yields them; "none" are answers known false that no perturbation yields.

    "look-alike without action sitting" and its like count as one.
    """
    return _counted(
        (
            {"template": one.posed.template, "yielded_by": (name or "none").split(" without ")[0]}
            for one in asked
            for position, name in enumerate(one.distractors, start=1)
            if isinstance(one.posed.answer, Choice) and position != one.posed.answer.choice
        ),
        within=("template",),
    )


def _distributions(asked: Sequence[Asked]) -> list[dict[str, Any]]:
    """Every bin of every measure, also the empty ones."""
    rows = []
    for name, edges in MEASURES.items():
        values = np.array([one.measures[name] for one in asked], float)
        counts = np.bincount(np.searchsorted(edges, values, side="right") - 1, minlength=len(edges))
        for number, n in enumerate(counts.tolist()):
            bin_name = _bin_name(name, edges, number)
            rows.append({"what": name, "bin": bin_name, "n": n, "share": n / max(1, len(asked))})
    return rows


def _bin_name(what: str, edges: Sequence[float], number: int) -> str:
    """ "3" or "6-7" of what is counted, else "[20, 40)"; the last is "12+"."""
    low = edges[number]
    if number + 1 == len(edges):
        return f"{low:g}+"
    high = edges[number + 1]
    if what == "time_gap_s" and number < 2:
        return ("0", f"(0, {high:g})")[number]
    if what in ("time_gap_s", "separation_deg", "apart_deg"):
        return f"[{low:g}, {high:g})"
    return f"{low:g}" if high == low + 1 else f"{low:g}-{high - 1:g}"


def _spread(asked: Sequence[Asked]) -> list[dict[str, Any]]:
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    for one in asked:
        for name, value in one.measures.items():
            values[one.posed.template, name].append(value)
    return [
        {
            "template": template,
            "what": name,
            "n": len(values[template, name]),
            "min": min(values[template, name]),
            "median": float(median(values[template, name])),
            "mean": sum(values[template, name]) / len(values[template, name]),
            "max": max(values[template, name]),
        }
        for template in sorted({template for template, _ in values})
        for name in MEASURES
    ]


def _refusals(rejected: list[dict[str, Any]]) -> list[dict[str, Any]]:
    counts: Counter[tuple[str, str, str]] = Counter()
    for row in rejected:
        if row["kind"] == "count":
            counts[row["family"], row["template"], row["rule"]] += row["candidates"]
    return [
        {"family": family, "template": template, "rule": rule, "candidates": count}
        for (family, template, rule), count in sorted(counts.items())
    ]


def _lacking(layers: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    """Templates that some sequences cannot carry, with the layer and how many sequences lack it."""
    rows = []
    for name, forms in FORMS.items():
        # What any form can do without, the template can.
        for layer in min((form.layers for form in forms), key=len):
            without = sum(layer not in present for present in layers.values())
            if without:
                row = {"family": forms[0].family, "template": name, "layer": layer}
                rows.append(row | {"sequences_without": without, "sequences": len(layers)})
    return rows


def _layers(sequences: Sequence[Sequence[str]]) -> list[dict[str, Any]]:
    """Each layer that there can be, with the sequences that have it."""
    counts = Counter(layer for layers in sequences for layer in layers)
    return [{"layer": layer, "sequences_with": counts[layer], "sequences": len(sequences)} for layer in LAYERS]
