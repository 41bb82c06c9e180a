"""Reasons for the number of questions per template: candidates, refusals by rule, and missing layers.

The commands `generate` and `stats` report the same, because all numbers come from published tables.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.schema.templates import FAMILIES, forms_of

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

REFUSALS: Final = tuple(REASONS)

_NAMED: Final = 2
"""Number of named rules per template. They are the rules that refused most candidates."""

Example = tuple[int, str, str | None]
"""Target, plan and detail of a refused candidate."""


def refusal_rows(
    sequence: str, template: str, rule: str, count: int, examples: Sequence[Example] = ()
) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table `rejected` for one rule.

    Args:
        sequence: Name of the sequence.
        template: Name of the template.
        rule: Name of the rule.
        count: Number of candidates that the rule refused.
        examples: Refused candidates that become examples.

    Yields:
        The row with the number, then the rows of examples.
    """
    row = {"sequence": sequence, "family": FAMILIES[template], "template": template, "rule": rule}
    yield row | {"kind": "count", "candidates": count}
    for target, plan, detail in examples:
        yield row | {"kind": "example", "candidates": 1, "target_track": target, "plan": plan, "detail": detail}


def tallies(rejected: pa.Table, questions: pa.Table) -> list[dict[str, Any]]:
    """Count the candidates of each template.

    Args:
        rejected: Table `rejected`.
        questions: Questions with their templates.

    Returns:
        A row per template: family, template, candidates, a column per rule of `RULES`, proven, a column per further
        rule, and questions.
    """
    counts = rejected.filter(pc.equal(rejected["kind"], "count")).select(["template", "rule", "candidates"])
    refused: Counter[tuple[str, str]] = Counter()
    for line in counts.to_pylist():
        refused[line["template"], line["rule"]] += line["candidates"]
    questions_of = Counter(questions["template"].to_pylist())
    rows = []
    for name, family in FAMILIES.items():
        before = {rule: refused[name, rule] for rule in RULES}
        after = {rule: refused[name, rule] for rule in REFUSALS if rule not in RULES}
        proven = sum(after.values()) + questions_of[name]
        row = {"family": family, "template": name, "candidates": proven + sum(before.values()), **before}
        rows.append(row | {"proven": proven, **after, "questions": questions_of[name]})
    return rows


def shortfalls(
    rows: Sequence[Mapping[str, Any]],
    lacking: Mapping[tuple[str, str], int],
    sequences: int,
    selection: Sequence[Mapping[str, Any]] = (),
) -> list[dict[str, Any]]:
    """Explain the number of questions of each template.

    Args:
        rows: Result of `tallies`.
        lacking: Number of sequences without a layer, by template and layer.
        sequences: Number of sequences.
        selection: Report of `select`, or nothing.

    Returns:
        A row per template: family, template, candidates, proven, questions, the rules that refused most candidates, and
        missing layers. The column `why` is a reason if the questions are fewer than requested, or fewer than `FEW`, or
        if sequences lack a layer. Otherwise it is None.
    """
    found = []
    selected = {row["template"]: row for row in selection}
    for row in rows:
        name = row["template"]
        wanted, shortage = (selected.get(name, {}).get(column) for column in ("quota", "shortage"))
        ranked = sorted((rule for rule in REFUSALS if row[rule]), key=lambda rule: -row[rule])
        # The selection is named, too, if it refused most of the proven candidates, or too many.
        most = ranked[:_NAMED] + [
            rule for rule in ranked[_NAMED:] if rule == "selection" and (shortage or row[rule] > row["questions"])
        ]
        shares = [f"{rule} {_percent(row[rule], row['candidates'])}" for rule in most]
        missing = {layer: count for (template, layer), count in sorted(lacking.items()) if template == name}
        skipped = [_without(layer, count, sequences) for layer, count in missing.items()]
        why = [f"skipped, {text}" for text in skipped]
        few = row["questions"] < (FEW if wanted is None else min(FEW, wanted))
        if (few or shortage) and all(count < sequences for count in missing.values()):
            why += _why_few(row, most, REASONS | ({"selection": shortage} if shortage else {}))
        known = {column: row[column] for column in ("family", "template", "candidates", "proven", "questions")}
        texts = {"refused_most": ", ".join(shares), "skipped": "; ".join(skipped), "why": "; ".join(why)}
        found.append(known | {column: text or None for column, text in texts.items()})
    return found


def _why_few(row: Mapping[str, Any], most: Sequence[str], reasons: Mapping[str, str]) -> list[str]:
    if not row["candidates"]:
        return [f"no candidate, nowhere is it certain that {forms_of(row['template'])[0].seeks}"]
    numbers = f"{_number(row['questions'], 'question')} of {_number(row['candidates'], 'candidate')}"
    refused = [f"{rule} refused {_percent(row[rule], row['candidates'])}: {reasons[rule]}" for rule in most]
    return [f"{numbers}, {row['proven']:,} proven", *refused]


def _number(count: int, what: str) -> str:
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def _without(layer: str, count: int, sequences: int) -> str:
    where = "" if count == sequences else f" in {count} of {sequences} sequences"
    return f"the layer {layer} is missing{where}"


def _percent(part: int, whole: int) -> str:
    return "<1 %" if 200 * part < whole else f"{100 * part / whole:.0f} %"
