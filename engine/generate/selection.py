"""Selection: which proven candidates of all sequences become questions, and how many of each family and template.

The result depends on the rows of the pool alone, never on their order: `key` decides among equals (sha256 hex of
sequence, target and plan). `near_duplicates` says which questions may stand beside each other, `balance` which
candidates of a form come first and how many of an answer stay.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final, TypeVar

import msgspec
import pyarrow as pa

from jrdb_avr.engine.generate.balance import Form, Option
from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import FAMILIES, TEMPLATES
from jrdb_avr.schema.wording.text import question_id

POOL: Final = pa.schema(
    [
        *dict.fromkeys((*QUESTIONS["questions"], *QUESTIONS["answers"])),
        ("key", pa.string()),
        ("form", pa.string()),
        ("answer_text", pa.string()),
        ("stated", pa.list_(pa.string())),
        ("times", pa.list_(pa.int32())),
        ("read_frames", pa.list_(pa.int32())),
        ("event", pa.string()),
        ("sets", pa.list_(pa.string())),
    ]
)
"""Columns of the records that selection chooses from: those of the tables `questions` and `answers`, and what it goes
by. `form` is a name of TEMPLATES; `answer_text` a choice's answer or another answer's stored JSON; `stated` the action
words of the question; `times` its stated frames; `read_frames` those where the answer is read; `event` the start or the
count of the target that only one question may be about, null for none; `sets` the sets of choices that it may have, as
JSON of `distractors.Choices`."""

PROFILES: Final[dict[str, dict[str, int]]] = {
    "all": {},
    "paper": {
        "action_boundary": 67,
        "chain_2hop": 76,
        "chain_3hop": 222,
        "chain_fork_join": 32,
        "chain_hybrid": 51,
        "long_range": 30,
        "unique_anchor": 1620,
    },
}
"""Questions per family, in the order of the paper's table; a family not named keeps all that balance leaves."""

_PUBLIC: Final = ("sequence", "family", "template", "question", "choices", "answer_mode")

K = TypeVar("K", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected rows by sequence, template and key, and one report row per template."""

    table: pa.Table
    report: tuple[dict[str, Any], ...]


def select(table: pa.Table, rules: Rules, profile: str, seed: int) -> Selection:
    """Choose among the candidates of all sequences; under a profile, its number per family.

    No answer takes more than `max_answer_share` of a choice template. What one template of a family cannot give, the
    others give; what one form of a template cannot give, its others give. Families with few candidates for their number
    choose first, as a person is in `max_per_person_in_all` questions at most. `profile` is a name of PROFILES.

    The report has a row for every template: family, template, candidates, aim (its even part of the family's number,
    None where there is none) and kept (selected).
    """
    taken = Taken(rules)
    rows: dict[str, list[int]] = defaultdict(list)
    for row, name in enumerate(table["form"].to_pylist()):
        rows[name].append(row)
    forms: dict[str, list[Form]] = defaultdict(list)
    for name in sorted(rows):
        forms[TEMPLATES[name].name].append(Form(table, rows[name], name, taken, seed))
    wanted = PROFILES[profile]
    families = list(dict.fromkeys(FAMILIES.values()))
    sizes = Counter(table["family"].to_pylist())
    for family in sorted(families, key=lambda name: (sizes[name] / max(wanted.get(name, 1), 1), name)):
        _choose({name: forms.get(name, []) for name in _templates_of(family)}, wanted.get(family))
    report: list[dict[str, Any]] = []
    for family in families:
        names = _templates_of(family)
        aims = _even_shares(names, wanted[family]) if family in wanted else {}
        for name in names:
            own = forms.get(name, [])
            counts = {"candidates": sum(form.candidates for form in own), "aim": aims.get(name)}
            kept = sum(len(form.chosen) for form in own)
            report.append({"family": family, "template": name, **counts, "kept": kept})
    chosen = [form.options[number] for form in chain(*forms.values()) for number in form.chosen]
    order = [(name, "ascending") for name in ("sequence", "template", "key", "plan")]
    return Selection(_with_choices(table, chosen).sort_by(order), tuple(report))


def _with_choices(table: pa.Table, options: Sequence[Option]) -> pa.Table:
    """The rows of these options with their sets of choices, and so with other ids."""
    rows = table.take(pa.array([option.row for option in options], pa.int64())).to_pylist()
    for row, choices in zip(rows, (option.choices for option in options), strict=True):
        if choices:
            row["choices"] = list(choices.texts)
            row["question_id"] = question_id(**{name: row[name] for name in _PUBLIC})
            row["answer"] = encode_answer(Choice(choices.true))
            row["distractors"] = msgspec.json.encode(choices.perturbations).decode()
    return pa.Table.from_pylist(rows, schema=table.schema)


def _templates_of(family: str) -> list[str]:
    return [name for name in sorted(FAMILIES) if FAMILIES[name] == family]


def _choose(forms: Mapping[str, Sequence[Form]], wanted: int | None) -> None:
    """Let every form of every template of a family choose, `wanted` in all if they have so many."""
    if wanted is None:
        for form in chain(*forms.values()):
            form.extend(form.candidates)
            # Of fewer no guesser's share is reliable.
            if form.within_sets and len(form.chosen) < FEW:
                form.loosen()
                form.extend(FEW - len(form.chosen))
        return
    left = wanted - _deal(forms, wanted)
    # What they lack with answers that are level in each set of choices and with the same words, they give with answers
    # that are level in all.
    loose = [form for form in chain(*forms.values()) if form.within_sets]
    for form in loose:
        form.loosen()
    if left > 0 and loose:
        _deal(forms, left)


def _deal(forms: Mapping[str, Sequence[Form]], wanted: int) -> int:
    """Let the forms choose so many more, shared out evenly; returns how many they choose."""
    left = wanted
    # Nobody knows before how many a form can give: what one lacks is shared out among the others again.
    while left > 0 and (open_names := [name for name, own in forms.items() if any(not form.spent for form in own)]):
        before = left
        for name, share in _even_shares(open_names, left).items():
            own = [form for form in forms[name] if not form.spent]
            for form, part in _even_shares(own, share).items():
                left -= form.extend(part)
        if left == before:
            # Some shares are too small for any number of answers: whoever can take all that is left.
            for form in chain(*forms.values()):
                left -= form.extend(left)
            break
    return wanted - left


def _even_shares(names: Collection[K], wanted: int) -> dict[K, int]:
    """Even shares of `wanted`, the first ones larger by one where they must be."""
    share, extra = divmod(wanted, len(names))
    return {name: share + (place < extra) for place, name in enumerate(names)}
