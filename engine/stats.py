"""What a benchmark holds: counts, distributions, and how well it can be answered without looking."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any, Final

import msgspec

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice

from .blind import Posed, blind_check, posed
from .selection import GAP_EDGES_S, OFFSET_EDGES_S, answer_bin
from .templates import TEMPLATES, by_name

TITLES: Final = {
    "family": "Questions per family",
    "template": "Questions per template",
    "sequence": "Questions per sequence",
    "answer": "Answers per template (of times: offset from the description, or length, in seconds)",
    "position": "Position of the true choice",
    "distractor": "What wrong choices are",
    "spread": "Time, turn and crowd per template (smallest, median, largest)",
    "refusal": "Candidates refused, by rule",
    "lacking": "Templates that lack a layer",
    "blind": "Answering without looking: shares of right answers",
}
"""The tables of `stats`, in the order in which they are printed."""


def statistics(store: Store) -> dict[str, list[dict[str, Any]]]:
    """Rows of every table in TITLES. Raises StoreError where there are no questions."""
    questions, answers = store.questions("questions"), store.questions("answers")
    rejected = store.questions("rejected").to_pylist()
    rows = questions.to_pylist()
    private = {row["question_id"]: row for row in answers.to_pylist()}
    read = posed(questions, answers)
    family_of = {row["template"]: row["family"] for row in rows}
    return {
        "family": _counted(rows, ("family",)),
        "template": _counted(rows, ("family", "template", "answer_mode")),
        "sequence": _sequences(rows, private),
        "answer": _answers(read),
        "position": _positions(read),
        "distractor": _distractors(rows, private),
        "spread": _spread(rows, private),
        "refusal": _refusals(rejected),
        "lacking": _lacking(store),
        "blind": [{"family": family_of[row["template"].split(" (")[0]], **row} for row in blind_check(read)],
    }


def _counted(rows: Iterable[Mapping[str, Any]], names: tuple[str, ...]) -> list[dict[str, Any]]:
    counts = Counter(tuple(row[name] for name in names) for row in rows)
    return [
        dict(zip(names, key, strict=True)) | {"n": count, "share": count / counts.total()}
        for key, count in sorted(counts.items())
    ]


def _sequences(rows: list[dict[str, Any]], private: Mapping[str, dict[str, Any]]) -> list[dict[str, Any]]:
    people: dict[str, set[int]] = defaultdict(set)
    for row in rows:
        people[row["sequence"]].add(private[row["question_id"]]["target_track"])
    return [row | {"people asked about": len(people[row["sequence"]])} for row in _counted(rows, ("sequence",))]


def _answers(read: list[Posed]) -> list[dict[str, Any]]:
    counts: dict[str, Counter[tuple[int, str]]] = defaultdict(Counter)
    for question in read:
        counts[question.group][_answer_name(question)] += 1
    return [
        {"template": template, "answer": name, "n": n, "share": n / of_template.total()}
        for template, of_template in sorted(counts.items())
        for (_, name), n in sorted(of_template.items())
    ]


def _answer_name(question: Posed) -> tuple[int, str]:
    """(place, name) of the answer, or of the bin it lies in."""
    if isinstance(question.answer, Choice):
        return 0, question.choices[question.answer.choice - 1]
    number = answer_bin(question.mode, msgspec.json.encode(question.answer).decode(), question.times)
    edges = (0.0, *(GAP_EDGES_S if question.mode == "number" else OFFSET_EDGES_S))
    above = f"{edges[number + 1]:g}" if number + 1 < len(edges) else "inf"
    return number, f"[{edges[number]:g}, {above})"


def _positions(read: list[Posed]) -> list[dict[str, Any]]:
    counts: dict[str, Counter[int]] = defaultdict(Counter)
    for question in read:
        if isinstance(question.answer, Choice):
            counts[question.template][question.answer.choice] += 1
    return [
        {"template": template, "position": position, "n": n, "share": n / of_template.total()}
        for template, of_template in sorted(counts.items())
        for position, n in sorted(of_template.items())
    ]


def _distractors(rows: list[dict[str, Any]], private: Mapping[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Wrong choices by the perturbation that yields them; "plain" are those that no perturbation yields."""
    found = []
    for row in rows:
        own = private[row["question_id"]]
        if row["answer_mode"] != "multiple_choice":
            continue
        true = msgspec.json.decode(own["answer"], type=Choice).choice
        for position, name in enumerate(msgspec.json.decode(own["distractors"], type=list[str | None]), start=1):
            if position != true:
                # "look-alike without action sitting" and its like count as one kind.
                kind = (name or "plain").split(" without ")[0]
                found.append({"template": row["template"], "distractor": kind})
    return _counted_within(found, "template", "distractor")


def _counted_within(rows: Iterable[Mapping[str, Any]], whole: str, part: str) -> list[dict[str, Any]]:
    rows = list(rows)
    totals = Counter(row[whole] for row in rows)
    return [row | {"share": row["n"] / totals[row[whole]]} for row in _counted(rows, (whole, part))]


def _spread(rows: list[dict[str, Any]], private: Mapping[str, dict[str, Any]]) -> list[dict[str, Any]]:
    values: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        own = private[row["question_id"]]
        for name in ("time_gap_s", "separation_deg", "people_in_scene"):
            values[row["template"]][name].append(own[name])
    return [
        {"template": template, "what": name, "min": min(some), "median": float(median(some)), "max": max(some)}
        for template, of_template in sorted(values.items())
        for name, some in of_template.items()
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


def _lacking(store: Store) -> list[dict[str, Any]]:
    """Templates that some sequences cannot carry, with the layer and how many sequences lack it."""
    sequences = store.manifest().sequences
    rows = []
    for name, forms in by_name(TEMPLATES).items():
        # What any form can do without, the template can.
        for layer in min((form.layers for form in forms), key=len):
            without = sum(layer not in entry.layers for entry in sequences.values())
            if without:
                row = {"family": forms[0].family, "template": name, "layer": layer}
                rows.append(row | {"sequences without": without, "sequences": len(sequences)})
    return rows
