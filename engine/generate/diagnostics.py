"""Explain the number of questions per template: candidates, the rules that refused them, and what the scenes lack.

Computed from the published tables alone, so that `generate` and, at any later time, `stats` report the same.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.schema.templates import FAMILIES, forms_of

RULES: Final = {
    "held_out": "a held-out question needs one of its people at the same time",
    "stated": "the question's text states the answer",
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
"""Rules of the search with the reason why each refuses a candidate, in the order in which they are tried.

The last two drop a candidate before the others are tried, so that nobody knows whether it can be proven."""

REASONS: Final = RULES | {
    "choices": "fewer than three answers are certainly wrong",
    "unconfirmed": "another program gives another result, which is a defect of the software",
    "balance": "more would make one answer too common, pass a cap or the requested number, or resemble others",
}
"""All rules with the reason why each refuses a candidate. The rules after those of the search refuse proven ones."""

REFUSALS: Final = tuple(REASONS)

EXAMPLES: Final = 100
"""Maximum number of example rows per sequence, template and rule."""

_NAMED: Final = 2
"""How many of the rules that refused most are named per template."""

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
        examples: Refused candidates, of which the first become examples.

    Yields:
        The row with the number, then the rows of examples.
    """
    row = {"sequence": sequence, "family": FAMILIES[template], "template": template, "rule": rule}
    yield row | {"kind": "count", "candidates": count}
    for target, plan, detail in examples[:EXAMPLES]:
        yield row | {"kind": "example", "candidates": 1, "target_track": target, "plan": plan, "detail": detail}


def dropped_rows(pool: pa.Table, chosen: pa.Table, faults: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table `rejected` for the proven candidates that are not chosen.

    Args:
        pool: Proven candidates of all sequences, in the columns of `selection.POOL`.
        chosen: Chosen candidates, with the column `key`. Excluded questions count as dropped by balance.
        faults: Differences of the candidates that are not confirmed, by key.

    Yields:
        The rows.
    """
    groups: dict[tuple[str, str, str], list[Example]] = defaultdict(list)
    left = pool.filter(pc.invert(pc.is_in(pool["key"], value_set=chosen["key"].combine_chunks())))
    names = ["key", "sequence", "template", "target_track", "plan"]
    for row in left.select(names).sort_by("key").to_pylist():
        rule = "unconfirmed" if row["key"] in faults else "balance"
        groups[row["sequence"], row["template"], rule].append(
            (row["target_track"], row["plan"], faults.get(row["key"]))
        )
    for (sequence, template, rule), examples in groups.items():
        yield from refusal_rows(sequence, template, rule, len(examples), examples)


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
