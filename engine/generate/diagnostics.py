"""Reasons for the number of questions per template: candidates, refusals by rule, and missing layers.

The commands `generate` and `stats` report the same, because all numbers come from published tables.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import pyarrow as pa

from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.schema.templates import FAMILIES, FORMS, forms_of

RULES: Final = {
    "held_out": "a held-out question needs one of its people at the same time",
    "choices": "the question's text states the answer, or fewer than three wrong choices fit",
    "view.single": "answerable from a single view",
    "count": "the people who are met between keyframes are not certain",
    "anchor": "a condition of the description is not needed",
    "hop.stop": "stopping one person early gives the same answer, or one not known to differ",
    "hop.skip": "skipping a hop gives the same answer, or one not known to differ",
    "time.shift": "three seconds earlier or later the answer is not known to differ",
    "time.drop": "every other time gives the same answer",
    "near_duplicate": "another candidate about the same person and nearly the same moment stays",
    "max_per_person": "the person has the maximum number of candidates of this template and answer",
}
"""Rules of the search, in the order of the trials, each with the reason for a refusal.

The last two refuse candidates without a proof."""

REASONS: Final = RULES | {
    "unconfirmed": "another program gives another result, which is a defect of the software",
    "selection": "a near-duplicate, a cap, the quota or a guesser's bound leaves it out",
}
"""All rules, each with the reason for a refusal. The rules after the search refuse proven candidates."""

_NAMED: Final = 2
"""Number of named rules per template. They are the rules that refused most candidates."""


def tallies(
    rejected: pa.Table,
    questions: pa.Table,
    layers: Mapping[str, Sequence[str]],
    selection: Sequence[Mapping[str, Any]] = (),
) -> list[dict[str, Any]]:
    """Count the candidates of each template, and explain a small number of questions.

    Args:
        rejected: Table `rejected`.
        questions: Questions with their templates.
        layers: Layers of each sequence.
        selection: Report of `select`, or nothing.

    Returns:
        A row per template: family, template, candidates, a column per rule of `RULES`, proven, a column per further
        rule, questions and why. The column `why` is a reason if the questions are fewer than requested, or fewer than
        `FEW`, or if sequences lack a layer. Otherwise it is None.
    """
    sums = rejected.group_by(["template", "rule"]).aggregate([("candidates", "sum")]).to_pylist()
    refused = Counter({(row["template"], row["rule"]): row["candidates_sum"] for row in sums})
    questions_of = Counter(questions["template"].to_pylist())
    selected = {row["template"]: row for row in selection}
    rows = []
    for name, family in FAMILIES.items():
        before = {rule: refused[name, rule] for rule in RULES}
        after = {rule: refused[name, rule] for rule in REASONS if rule not in RULES}
        proven = sum(after.values()) + questions_of[name]
        row = {"family": family, "template": name, "candidates": proven + sum(before.values()), **before}
        row |= {"proven": proven, **after, "questions": questions_of[name]}
        # A template needs only the layers of its least demanding form.
        needed = min((form.layers for form in FORMS[name]), key=len)
        missing = Counter(layer for layer in sorted(needed) for present in layers.values() if layer not in present)
        why = _reasons(row, missing, len(layers), selected.get(name, {}))
        rows.append(row | {"why": "; ".join(why) or None})
    return rows


def _reasons(
    row: Mapping[str, Any], missing: Mapping[str, int], sequences: int, selected: Mapping[str, Any]
) -> Iterator[str]:
    """Yield why a template has few questions. `missing` has the number of sequences that lack a layer, by layer."""
    for layer, count in missing.items():
        where = "" if count == sequences else f" in {count} of {sequences} sequences"
        yield f"skipped, the layer {layer} is missing{where}"
    quota, shortage = selected.get("quota"), selected.get("shortage")
    enough = row["questions"] >= (FEW if quota is None else min(FEW, quota)) and not shortage
    if enough or sequences in missing.values():
        return
    if not row["candidates"]:
        yield f"no candidate, nowhere is it certain that {forms_of(row['template'])[0].seeks}"
        return
    yield ", ".join(f"{name}: {row[name]:,}" for name in ("candidates", "proven", "questions"))
    ranked = sorted((rule for rule in REASONS if row[rule]), key=lambda rule: -row[rule])
    for place, rule in enumerate(ranked):
        # The selection is named, too, if it refused most of the proven candidates, or too many.
        if place < _NAMED or (rule == "selection" and (shortage or row[rule] > row["questions"])):
            reason = shortage if shortage and rule == "selection" else REASONS[rule]
            percent = 100 * row[rule] / row["candidates"]
            yield f"{rule} refused {'<1' if percent < 0.5 else f'{percent:.0f}'} %: {reason}"
