"""Explain the number of questions per template: candidates, the rules that refused them, and what the scenes lack.

Computed from the published tables alone, so that `generate` and, at any later time, `stats` report the same.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.engine.generate.candidates import MEANINGS, RULES
from jrdb_avr.schema.templates import FAMILIES, forms_of

REASONS: Final = {
    **MEANINGS,
    "rederive": "the second program disagrees, which is a defect of the software",
    "choices": "fewer than three answers are certainly wrong",
    "near_duplicate": "another candidate about the same person and nearly the same moment stays",
    "max_per_person": "the person has the maximum number of candidates of this template and answer",
    "balance": "more would make one answer too common, pass a cap or the requested number, or resemble others",
}
"""Every rule that refuses a candidate, in the order in which they are tried, with why each refuses."""

REFUSALS: Final = tuple(REASONS)

_NAMED: Final = 2
"""How many of the rules that refused most are named per template."""


def refusal_row(
    line: Mapping[str, Any], rule: str, detail: str | None = None, count: int | None = None
) -> dict[str, Any]:
    """A row of `rejected`: how many candidates of `line`'s sequence and template a rule refused or, without a count,
    one of them as an example."""
    example = {"kind": "example", "candidates": 1, "target_track": line.get("target_track"), "plan": line.get("plan")}
    what = example if count is None else {"kind": "count", "candidates": count, "target_track": None, "plan": None}
    where = {"sequence": line["sequence"], "family": FAMILIES[line["template"]], "template": line["template"]}
    return {**what, **where, "rule": rule, "detail": detail}


def tallies(rejected: pa.Table, questions: pa.Table) -> list[dict[str, Any]]:
    """A row per template: family, template, candidates, refused by each of RULES, proven, by the others, questions."""
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
    """A row per template: how far its candidates came, the rules that refused most of them, and why they are few.

    `rows` are those of `tallies`; `lacking`: (template, layer) -> how many of `sequences` are without it; `selection`:
    the report of `select`. `why` is a sentence where there are fewer than FEW questions and fewer than requested, where
    balance leaves fewer than requested, or where sequences lack a layer, else None.
    """
    found = []
    selected = {row["template"]: row for row in selection}
    for row in rows:
        name = row["template"]
        wanted, shortage = (selected.get(name, {}).get(column) for column in ("aim", "shortage"))
        ranked = sorted((rule for rule in REFUSALS if row[rule]), key=lambda rule: -row[rule])
        # The rules that refused most, and balance where it refused most of the proven candidates, or too many.
        most = ranked[:_NAMED] + [
            rule for rule in ranked[_NAMED:] if rule == "balance" and (shortage or row[rule] > row["questions"])
        ]
        shares = [f"{rule} {_percent(row[rule], row['candidates'])}" for rule in most]
        missing = {layer: count for (template, layer), count in sorted(lacking.items()) if template == name}
        skipped = [_without(layer, count, sequences) for layer, count in missing.items()]
        why = [f"skipped, {text}" for text in skipped]
        few = row["questions"] < (FEW if wanted is None else min(FEW, wanted))
        if (few or shortage) and all(count < sequences for count in missing.values()):
            why += _why_few(row, most, REASONS | ({"balance": shortage} if shortage else {}))
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


def fillings(selection: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row per family with an aim: family, aimed, reached, missing, and which templates fill for which.

    `selection` is the report of `select`.
    """
    families: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for row in selection:
        if row["aim"] is not None:
            families[row["family"]].append(row)
    found = []
    for family, rows in families.items():
        aimed, reached = sum(row["aim"] for row in rows), sum(row["kept"] for row in rows)
        short = [f"{row['template']} {row['kept']} of {row['aim']}" for row in rows if row["kept"] < row["aim"]]
        more = [f"{row['template']} +{row['kept'] - row['aim']}" for row in rows if row["kept"] > row["aim"]]
        numbers = {"family": family, "aimed": aimed, "reached": reached, "missing": aimed - reached}
        found.append(numbers | {"short": ", ".join(short) or None, "filled_by": ", ".join(more) or None})
    return found
