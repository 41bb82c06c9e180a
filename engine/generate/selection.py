"""Selection: which proven candidates of all sequences become questions, and how many of each family and template.

The result depends on the rows of the pool alone, never on their order: `key` decides among equals (sha256 hex of
sequence, target and plan). `near_duplicates` says which questions may stand beside each other, `balance` which
candidates of a form come first and how many of an answer stay.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.engine.generate.balance import Form
from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.engine.generate.distractors import Choices
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

TRAIN: Final = "train"
"""The profile of training sets: of every template as many as there are, under `training_rules`."""

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
    TRAIN: {},
}
"""Questions per family, in the order of the paper's table; a family not named keeps all that balance leaves."""

_CHOICES: Final = msgspec.json.Decoder(Choices)

_PUBLIC: Final = ("sequence", "family", "template", "question", "choices", "answer_mode")


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected rows by sequence, template and key, each with the number of its set of choices in a column `set`
    (null where it has none), and one report row per template."""

    table: pa.Table
    report: tuple[dict[str, Any], ...]


def select(table: pa.Table, rules: Rules, profile: str, seed: int, n: int | None = None) -> Selection:
    """Choose among the candidates of all sequences; under a profile, its number per family, under TRAIN at most `n`.

    No answer takes more than `max_answer_share` of a choice template. What one template of a family cannot give, the
    others give; what one form of a template cannot give, its others give. Families with few candidates for their number
    choose first, as a person is in `max_per_person_in_all` questions at most. `profile` is a name of PROFILES.

    The report has a row for every template: family, template, candidates, aim (its even part of the family's number,
    None where there is none), kept (selected) and shortage (why balance keeps it from its aim or, without one, from
    FEW; else None).
    """
    taken = Taken(rules)
    rows: dict[str, list[int]] = defaultdict(list)
    for row, name in enumerate(table["form"].to_pylist()):
        rows[name].append(row)
    forms: dict[str, list[Form]] = defaultdict(list)
    for name in sorted(rows):
        forms[TEMPLATES[name].name].append(Form(table, rows[name], name, taken, seed))
    wanted = PROFILES[profile]
    families: dict[str, list[str]] = defaultdict(list)
    for name, family in FAMILIES.items():
        families[family].append(name)
    sizes = Counter(table["family"].to_pylist())
    aims: dict[str, int] = {}
    if profile == TRAIN:
        # Nothing balances a training set but the turns of templates and answers.
        _deal([forms[name] for name in sorted(forms)], len(table) if n is None else n)
        families_in_turn, enough = [], 0
    else:
        families_in_turn = sorted(families, key=lambda name: (sizes[name] / max(wanted.get(name, 1), 1), name))
        enough = FEW
    for family in families_in_turn:
        names = sorted(families[family])
        if family in wanted:
            aims |= zip(names, _even_shares(len(names), wanted[family]), strict=True)
        _choose([forms[name] for name in names], [aims.get(name) for name in names])
    report = tuple(
        {"family": family, "template": name, "candidates": sum(form.candidates for form in forms[name])}
        | {"aim": aims.get(name), "kept": _kept(forms[name])}
        | {"shortage": _shortage(forms[name], aims.get(name, enough))}
        for family, names in families.items()
        for name in sorted(names)
    )
    chosen = [form.options[number] for form in chain(*forms.values()) for number in form.chosen]
    selected = table.take(pa.array([option.row for option in chosen], pa.int64()))
    sets = pa.array([option.order[0] if option.set else None for option in chosen], pa.int64())
    order = [(name, "ascending") for name in ("sequence", "template", "key")]
    return Selection(selected.append_column("set", sets).sort_by(order), report)


def with_choices(pool: pa.Table, chosen: pa.Table) -> list[dict[str, Any]]:
    """Rows of the pool with their sets of choices, and so with other ids; `chosen` has the columns `row` and `set`."""
    rows: list[dict[str, Any]] = pool.take(chosen["row"]).to_pylist()
    for row, number in zip(rows, chosen["set"].to_pylist(), strict=True):
        if number is not None:
            choices = _CHOICES.decode(row["sets"][number])
            row["choices"] = list(choices.texts)
            row["question_id"] = question_id(**{name: row[name] for name in _PUBLIC})
            row["answer"] = encode_answer(Choice(choices.true))
            row["distractors"] = msgspec.json.encode(choices.perturbations).decode()
    return rows


def _kept(forms: Iterable[Form]) -> int:
    return sum(len(form.chosen) for form in forms)


def _shortage(forms: Sequence[Form], enough: int) -> str | None:
    return "; ".join(filter(None, (form.shortage() for form in forms if _kept(forms) < enough))) or None


def _choose(templates: Sequence[Sequence[Form]], aims: Sequence[int | None]) -> None:
    """Let the forms of a family's templates choose what each aims at, or all that they can where it has no aim."""
    for forms, aim in zip(templates, aims, strict=True):
        _deal([forms], sum(form.candidates for form in forms) if aim is None else aim)
        # Of fewer no guesser's share is reliable.
        lacking = (FEW if aim is None else min(FEW, aim)) - _kept(forms)
        if lacking > 0:
            _loosen(forms)
            _deal([forms], lacking)
    # What some cannot give, the others give: first as level as before, then level in each template as a whole.
    left = sum(aim or 0 for aim in aims) - _kept(chain(*templates))
    left -= _deal([[form for form in forms if not form.loose] for forms in templates], left)
    if left > 0:
        _loosen(chain(*templates))
        _deal(templates, left)


def _loosen(forms: Iterable[Form]) -> None:
    for form in forms:
        form.loosen()


def _deal(templates: Sequence[Sequence[Form]], wanted: int) -> int:
    """Let the forms choose so many more, shared out evenly; returns how many they choose."""
    left = wanted
    # Nobody knows before how many a form can give: what one lacks is shared out among the others again.
    while left > 0 and (able := [some for forms in templates if (some := [one for one in forms if not one.spent])]):
        before = left
        for forms, share in zip(able, _even_shares(len(able), left), strict=True):
            for form, part in zip(forms, _even_shares(len(forms), share), strict=True):
                left -= form.extend(part)
        if left == before:
            # Some shares are too small for any number of answers: whoever can take all that is left.
            for form in chain(*templates):
                left -= form.extend(left)
            break
    return wanted - left


def _even_shares(parts: int, whole: int) -> list[int]:
    """Even shares of a whole, the first ones larger by one where they must be."""
    share, extra = divmod(whole, parts)
    return [share + (place < extra) for place in range(parts)]
