"""Which proven candidates become questions: near-duplicates, caps and balance in one selection.

`thin_out` looks at one template in one sequence and drops what no selection can use; `select` looks across all. Both
depend on the rows alone, never on their order: `key` decides among equals (sha256 hex of sequence, target and plan).

The candidates of one form of a template are taken in turns over their answers (or over the bins that hold them), the
scarcest answer first. A candidate is refused where a near-duplicate or a cap forbids it. Among those of an answer the
one is preferred whose words and waits go with that answer least often so far, so that the text gives nothing away.

A pose question takes one of several sets of choices: the one that goes with its answer least often, so that whoever
knows which answer of each set is true most often is right no oftener than the share of one answer allows.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final, NamedTuple, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.bins import answer_bin, wait_bin
from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.engine.generate.distractors import Choices
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.labels import choice_text
from jrdb_avr.schema.rules import Rules, frames
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

_READ: Final = ["form", "answer_text", "times", "sequence", "target_track", "read_frames", "event", "stated", "key"]
_PUBLIC: Final = ("sequence", "family", "template", "question", "choices", "answer_mode")
_CHOICES: Final = msgspec.json.Decoder(Choices)

K = TypeVar("K", bound=Hashable)

KEPT: Final = ""
"""Verdict of `thin_out` on a row that stays."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected rows by sequence, template and key, and one report row per template."""

    table: pa.Table
    report: tuple[dict[str, Any], ...]


def near_s(template: str, rules: Rules) -> float:
    """Seconds within which two questions of a template read the same."""
    return rules.near_presence_s if template == "presence" else rules.near_duplicate_s


def thin_out(table: pa.Table, rules: Rules) -> npt.NDArray[np.str_]:
    """Per row of one template in one sequence: KEPT, or the rule that drops it.

    near_duplicate: every frame where the answer is read lies near those of a row of the same target and answer that
    stays, with a smaller key; max_per_person: as many as that of the target and answer stay already.
    """
    if not len(table):
        return np.full(0, KEPT)
    near = frames(near_s(table["template"][0].as_py(), rules))
    answer = table["answer"].combine_chunks().dictionary_encode().indices
    order = pc.sort_indices(
        table.append_column("code", answer),
        sort_keys=[(name, "ascending") for name in ("target_track", "code", "key")],
    ).to_numpy()
    groups = np.stack([table["target_track"].to_numpy(), answer.to_numpy()])[:, order]
    read = pc.list_flatten(table["read_frames"]).to_numpy().reshape(len(table), -1)
    verdicts = np.full(len(table), "max_per_person")
    for rows in np.split(order, np.flatnonzero(np.diff(groups).any(axis=0)) + 1):
        alive = rows
        for _ in range(rules.max_per_person):
            if not len(alive):
                break
            close = np.all(np.abs(read[alive] - read[alive[0]]) <= near, axis=1)
            verdicts[alive[close]] = "near_duplicate"
            verdicts[alive[0]] = KEPT
            alive = alive[~close]
    return verdicts


# -- all sequences ----------------------------------------------------------------------------------------------


def select(table: pa.Table, rules: Rules, profile: str, seed: int) -> Selection:
    """Choose among the candidates of all sequences; under a profile, its number per family.

    No answer takes more than `max_answer_share` of a choice template. What one template of a family cannot give, the
    others give; what one form of a template cannot give, its others give. Families with few candidates for their number
    choose first, as a person is in `max_per_person_in_all` questions at most. `profile` is a name of PROFILES.

    The report has a row for every template: family, template, candidates, aim (its even part of the family's number,
    None where there is none) and kept (selected).
    """
    taken = _Taken(rules)
    rows: dict[str, list[int]] = defaultdict(list)
    for row, name in enumerate(table["form"].to_pylist()):
        rows[name].append(row)
    forms: dict[str, list[_Form]] = defaultdict(list)
    for name in sorted(rows):
        forms[TEMPLATES[name].name].append(_Form(table, np.array(rows[name]), taken, seed))
    wanted = PROFILES[profile]
    families = list(dict.fromkeys(FAMILIES.values()))
    sizes = Counter(table["family"].to_pylist())
    for family in sorted(families, key=lambda name: (sizes[name] / max(wanted.get(name, 1), 1), name)):
        _choose({name: forms.get(name, []) for name in _templates_of(family)}, wanted.get(family))
    report: list[dict[str, Any]] = []
    for family in families:
        names = _templates_of(family)
        aims = _share_out(dict.fromkeys(names, wanted[family]), wanted[family]) if family in wanted else {}
        for name in names:
            own = forms.get(name, [])
            counts = {"candidates": sum(len(set(form.rows.tolist())) for form in own), "aim": aims.get(name)}
            kept = sum(len(form.chosen) for form in own)
            report.append({"family": family, "template": name, **counts, "kept": kept})
    picked = [(form, place) for form in chain(*forms.values()) for place in form.chosen]
    places = pa.array([int(form.rows[place]) for form, place in picked], pa.int64())
    chosen = with_choices(table.take(places), [form.sets[place] for form, place in picked])
    order = [(name, "ascending") for name in ("sequence", "template", "key", "plan")]
    return Selection(chosen.sort_by(order), tuple(report))


def with_choices(table: pa.Table, sets: Sequence[str]) -> pa.Table:
    """The rows with these sets of choices, and so with other ids; an empty text leaves a row as it is."""
    rows = table.to_pylist()
    for row, text in zip(rows, sets, strict=True):
        if text:
            choices = _CHOICES.decode(text)
            row["choices"] = list(choices.texts)
            row["question_id"] = question_id(**{name: row[name] for name in _PUBLIC})
            row["answer"] = encode_answer(Choice(choices.true))
            row["distractors"] = msgspec.json.encode(choices.perturbations).decode()
    return pa.Table.from_pylist(rows, schema=table.schema)


def _templates_of(family: str) -> list[str]:
    return [name for name in sorted(FAMILIES) if FAMILIES[name] == family]


def _choose(forms: Mapping[str, Sequence[_Form]], wanted: int | None) -> None:
    """Let every form of every template of a family choose, `wanted` in all if they have so many."""
    if wanted is None:
        for form in chain(*forms.values()):
            form.extend(len(form.rows))
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


def _deal(forms: Mapping[str, Sequence[_Form]], wanted: int) -> int:
    """Let the forms choose so many more, shared out evenly; returns how many they choose."""
    left = wanted
    # Nobody knows before how many a form can give: what one lacks is shared out among the others again.
    while left > 0 and (open_names := [name for name, own in forms.items() if any(not form.spent for form in own)]):
        before = left
        for name, share in _share_out(dict.fromkeys(open_names, left), left).items():
            own = [form for form in forms[name] if not form.spent]
            for place, part in _share_out(dict.fromkeys(range(len(own)), share), share).items():
                left -= own[place].extend(part)
        if left == before:
            # Some shares are too small for any number of answers: whoever can take all that is left.
            for form in chain(*forms.values()):
                left -= form.extend(left)
            break
    return wanted - left


def _share_out(available: Mapping[K, int], wanted: int) -> dict[K, int]:
    """Even shares of `wanted`, in the order of names; what one cannot give is shared among the others."""
    quotas = dict.fromkeys(available, 0)
    left = wanted
    while left > 0 and (open_names := [name for name in available if quotas[name] < available[name]]):
        share, extra = divmod(left, len(open_names))
        for position, name in enumerate(open_names):
            step = min(share + (position < extra), available[name] - quotas[name])
            quotas[name] += step
            left -= step
    return quotas


# -- what may still be chosen -----------------------------------------------------------------------------------------

Person = tuple[str, int]
"""Sequence and track."""


class _Place(NamedTuple):
    """What forbids two questions beside each other: see POOL."""

    person: Person
    template: str
    read: tuple[int, ...]
    event: str | None


@dataclass
class _Taken:
    """What is chosen so far, of all templates, and so what may not be chosen besides."""

    rules: Rules
    reads: dict[tuple[Person, str], list[tuple[int, ...]]] = field(default_factory=lambda: defaultdict(list))
    events: set[tuple[Person, str]] = field(default_factory=set)
    questions: Counter[Person] = field(default_factory=Counter)

    def admits(self, one: _Place) -> bool:
        """Whether no near-duplicate and no cap forbids a question."""
        others = self.reads[one.person, one.template]
        if len(others) >= self.rules.max_per_person or self.questions[one.person] >= self.rules.max_per_person_in_all:
            return False
        if one.event is not None and (one.person, one.event) in self.events:
            return False
        near = frames(near_s(one.template, self.rules))
        return not any(_close(one.read, other, near) for other in others)

    def add(self, one: _Place) -> None:
        """Count a question as chosen."""
        self.reads[one.person, one.template].append(one.read)
        self.questions[one.person] += 1
        if one.event is not None:
            self.events.add((one.person, one.event))

    def remove(self, one: _Place) -> None:
        """Count a question as chosen no more."""
        self.reads[one.person, one.template].remove(one.read)
        self.questions[one.person] -= 1
        self.events.discard((one.person, one.event or ""))


def _close(one: tuple[int, ...], other: tuple[int, ...], near: int) -> bool:
    """Whether all frames of two questions lie near each other; forms that read at more frames are not alike."""
    return len(one) == len(other) and all(abs(a - b) <= near for a, b in zip(one, other, strict=True))


# -- balance ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Limit:
    """The most that one answer should take of the questions of a form.

    strict: it is a rule; otherwise an aim, and where too few could stay under it, all do. neighbors: the limit is
    on any two bins next to each other.
    """

    share: float
    strict: bool = False
    neighbors: bool = False

    def stay(self, answers: Ints) -> Ints:
        """The places of these answers, which stand in the order of choice, that stay so that the limit is met."""
        size, rank = len(answers), _ranks(answers)
        while True:
            most = int(self.share * size + 1e-9)
            stays = np.flatnonzero(rank < (_under_pairs(answers, most)[answers] if self.neighbors else most))
            if len(stays) >= size:
                return stays[:size]
            # Fewer questions leave each answer less room, so there are no more than these.
            size = len(stays)


def _ranks(answers: Ints) -> Ints:
    """How many equal answers stand before each."""
    order = np.argsort(answers, kind="stable")
    counts = np.bincount(answers)
    ranks = np.empty(len(answers), np.int64)
    ranks[order] = np.arange(len(answers)) - np.repeat(np.cumsum(counts) - counts, counts)
    return ranks


def _under_pairs(answers: Ints, most: int) -> Ints:
    """The most of each answer with no more than `most` of two that are next to each other.

    Whatever an answer leaves, only the next one could take, so every answer takes what it can.
    """
    limits, before = np.bincount(answers), 0
    for number, count in enumerate(limits.tolist()):
        before = limits[number] = min(count, most - before)
    return limits


_LIMITS: Final = {
    # A guess of one offset can win a bin of the near ones whole.
    **dict.fromkeys(("start", "span", "start_view"), _Limit(0.25)),
    # A guess of one length, right within a factor of two, wins two bins, or parts of three.
    "seconds_between": _Limit(0.5, neighbors=True),
    "count": _Limit(0.34),
}
"""By read; all others are choices, under `max_answer_share`."""

_FREE: Final = 2
"""So many questions of a cell may have the same answer, whatever others have."""

_PRIOR: Final = 5.0
"""So many questions of a set of choices are expected to have the answers that all questions have."""

_WORTH: Final = 0.1
"""An aim is met where at least this share of what could be chosen stays."""


class _Form:
    """The candidates of one form of a template, and those of them that are chosen, in the order of choice.

    A *place* is a candidate with one of its sets of choices, which are those of its *slot*. A *cell* holds the places
    whose questions state the same action words, with waits in the same doubling bins; it has a slot for each set.
    """

    def __init__(self, table: pa.Table, rows: Ints, taken: _Taken, seed: int) -> None:
        offered = [one or [""] for one in table["sets"].take(pa.array(rows)).to_pylist()]
        self.sets = [text for one in offered for text in one]
        rows = np.repeat(rows, [len(one) for one in offered])
        own = table.select(_READ).take(pa.array(rows))
        form = TEMPLATES[own["form"][0].as_py()]
        texts, times = own["answer_text"].to_pylist(), own["times"].to_pylist()
        mode, read = form.spec.mode, form.spec.read
        self.rows, self.taken = rows, taken
        self.limit = _LIMITS.get(read) or _Limit(taken.rules.max_answer_share, strict=True)
        self.answers = (
            _dense(texts)
            if mode == "multiple_choice"
            else np.array([answer_bin(mode, *pair, read) for pair in zip(texts, times, strict=True)], np.int64)
        )
        self.places = [
            _Place((sequence, track), form.name, tuple(frames), event)
            for sequence, track, frames, event in zip(
                *(own[name].to_pylist() for name in ("sequence", "target_track", "read_frames", "event")), strict=True
            )
        ]
        waits = [tuple(wait_bin(time - first) for time in more) for first, *more in times]
        self.cells = _dense(list(zip(map(" | ".join, own["stated"].to_pylist()), waits, strict=True)))
        choices = [tuple(sorted(_CHOICES.decode(text).texts)) if text else () for text in self.sets]
        sets = _dense(choices)
        self.slots = _dense(list(zip(self.cells.tolist(), sets.tolist(), strict=True)))
        self.slot_cells, self.slot_sets = (np.zeros(int(self.slots.max()) + 1, np.int64) for _ in range(2))
        self.slot_cells[self.slots], self.slot_sets[self.slots] = self.cells, sets
        hashes = _dense([hashlib.sha256(f"{seed} {key}".encode()).hexdigest() for key in own["key"].to_pylist()])
        sets_before = np.concatenate([np.arange(len(one)) for one in offered])
        self.sizes = np.bincount(self.answers)
        self.blocks = self._blocks(frames(near_s(form.name, taken.rules)))
        order = np.lexsort((hashes, sets_before, self.blocks))
        self.queues: dict[int, dict[int, list[int]]] = defaultdict(lambda: defaultdict(list))
        """By answer and slot, the places still to be tried; the last one comes first."""
        for place in order[::-1].tolist():
            self.queues[int(self.answers[place])][int(self.slots[place])].append(place)
        answers = int(self.answers.max()) + 1
        self.together = np.zeros((int(self.cells.max()) + 1, answers), np.int64)
        """(cells, answers): how many are chosen."""
        possible = np.zeros_like(self.together, bool)
        possible[self.cells, self.answers] = True
        self.varieties = possible.sum(axis=1)
        """Per cell, how many different answers its candidates have."""
        self.by_set = np.zeros((int(sets.max()) + 1, answers), np.int64)
        """(sets, answers): how many are chosen."""
        self.offers = np.ones_like(self.by_set, bool)
        """(sets, answers): whether an answer is among the choices."""
        for number, one in set(zip(sets.tolist(), choices, strict=True)):
            if one:
                self.offers[number] = [choice_text(text) in one for text in sorted(set(texts))]
        self.within_sets = len(self.by_set) > 1
        """Whether the limit holds for the answers of each set of choices."""
        self.loose = False
        """Whether the answer may go with the words more often than others do."""
        self.chosen: list[int] = []
        self.ended = False

    def loosen(self) -> None:
        """Level the answers over all questions from now on, and no more in each set of choices and with each word."""
        self.within_sets, self.loose = False, True

    def _blocks(self, near: int) -> Ints:
        """Per place, how many of scarcer answers could not be chosen beside it, as they are near-duplicates."""
        of_person: dict[Person, list[int]] = defaultdict(list)
        for number, place in enumerate(self.places):
            of_person[place.person].append(number)
        counts = np.zeros(len(self.places), np.int64)
        for numbers in of_person.values():
            read, answers = np.array([self.places[number].read for number in numbers]), self.answers[numbers]
            scarcer = self.sizes[answers] < self.sizes[answers][:, None]
            close = scarcer & (np.abs(read[:, None] - read) <= near).all(axis=2)
            counts[numbers] = close.sum(axis=1)
        return counts

    @property
    def spent(self) -> bool:
        """Whether no more can be chosen."""
        return self.ended or not self.queues

    def extend(self, more: int) -> int:
        """Choose so many more, or fewer where candidates or the limit on answers end; returns how many."""
        before = len(self.chosen)
        while len(self.chosen) < before + more:
            counts = self.together.sum(axis=0)
            # Every answer in its turn, the scarcest first.
            turns = sorted(self.queues, key=lambda one: (counts[one], self.sizes[one], one))
            if not any(self._choose_one(answer) for answer in turns):
                break
        self._cut()
        return len(self.chosen) - before

    def _choose_one(self, answer: int) -> bool:
        """Choose a candidate with this answer, if any may still be chosen; returns whether one was."""
        queues = self.queues[answer]
        while queues:
            slots = np.array(sorted(queues))
            if self.within_sets:
                # One more than its share is let in, or nothing could be the first of its set.
                counts = self.by_set[self.slot_sets[slots]]
                slots = slots[counts[:, answer] <= self.limit.share * (counts.sum(axis=1) + 1)]
            if not len(slots):
                return False
            cells, sets = self.slot_cells[slots], self.slot_sets[slots]
            own, total, variety = self.together[cells, answer], self.together[cells].sum(axis=1), self.varieties[cells]
            # How much oftener the answer goes with the words and waits of a cell than the others that could.
            excess = own - (total - own) / np.maximum(variety - 1, 1)
            telling = (variety > 1) & (own >= _FREE) & (excess > 0) & (own > self.limit.share * (total + 1))
            # How often the answer goes with a set of choices, smoothed by how often it goes with any.
            prior = _PRIOR * (self.by_set.sum(axis=0) + 1) / (len(self.chosen) + 1)
            with_set = self.by_set[sets].sum(axis=1) + self.offers[sets] @ prior
            likely = (self.by_set[sets, answer] + prior[answer]) / with_set
            blocks = [self.blocks[queues[slot][-1]] for slot in slots.tolist()]
            best = np.lexsort((slots, -variety, excess, likely, blocks, telling))[0]
            if telling[best] and self.limit.strict and not self.loose:
                return False
            slot = int(slots[best])
            place = queues[slot].pop()
            if not queues[slot]:
                del queues[slot]
            if not queues:
                del self.queues[answer]
            if self.taken.admits(self.places[place]):
                self.taken.add(self.places[place])
                self._count(place, 1)
                self.chosen.append(place)
                return True
        return False

    def _count(self, place: int, step: int) -> None:
        slot, answer = self.slots[place], self.answers[place]
        self.together[self.slot_cells[slot], answer] += step
        self.by_set[self.slot_sets[slot], answer] += step

    def _give_back(self, place: int) -> None:
        self.chosen.remove(place)
        self.taken.remove(self.places[place])
        self._count(place, -1)
        self.queues[int(self.answers[place])][int(self.slots[place])].append(place)

    def _cut(self) -> None:
        """Give back what is too many for the limit on answers."""
        while self.within_sets and self.by_set.max(axis=1).sum() > self.limit.share * len(self.chosen) + 1e-9:
            worst = int((self.by_set.max(axis=1) - self.limit.share * self.by_set.sum(axis=1)).argmax())
            pair = worst, int(self.by_set[worst].argmax())
            held = ((self.slot_sets[self.slots[place]], self.answers[place]) for place in reversed(self.chosen))
            self._give_back(next(place for place, own in zip(reversed(self.chosen), held, strict=True) if own == pair))
        stays = self.limit.stay(self.answers[self.chosen])
        if not self.limit.strict:
            # Turns are even as long as every answer has some left.
            self.ended = not self.queues
            if not self.ended or len(stays) < _WORTH * len(self.chosen):
                return
        kept = {self.chosen[number] for number in stays.tolist()}
        for place in [place for place in reversed(self.chosen) if place not in kept]:
            self._give_back(place)


def _dense(values: Sequence[Hashable]) -> Ints:
    """Every value as its place among the distinct ones."""
    place = {value: number for number, value in enumerate(sorted(set(values)))}  # type: ignore[type-var]
    return np.array([place[value] for value in values], np.int64)
