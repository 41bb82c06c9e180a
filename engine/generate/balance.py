"""Balance: which candidates of one form of a template are chosen, so that a question's text tells no answer.

The candidates are taken in turns over their answers (or over the bins that hold them), the scarcest answer first. Among
those of an answer the one is preferred whose words and waits go with that answer least often so far.

A pose question takes one of several sets of choices: the one that goes with its answer least often, so that whoever
knows which answer of each set is true most often is right no oftener than the share of one answer allows.
"""

from __future__ import annotations

import copy
import hashlib
from collections import Counter, defaultdict
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.engine.generate.bins import answer_bin, bin_name, wait_bin
from jrdb_avr.engine.generate.distractors import Choices
from jrdb_avr.engine.generate.near_duplicates import Person, Subject, Taken, near_frames
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.labels import choice_text
from jrdb_avr.schema.templates import TEMPLATES

_CHOICES: Final = msgspec.json.Decoder(Choices)


@dataclass(frozen=True, slots=True)
class Limit:
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


LIMITS: Final = {
    # A guess of one offset can win a bin of the near ones whole.
    **dict.fromkeys(("start", "span", "start_view"), Limit(0.25)),
    # A guess of one length, right within a factor of two, wins two bins, or parts of three.
    "seconds_between": Limit(0.5, neighbors=True),
    "count": Limit(0.34),
}
"""By read; all others are choices, under `max_answer_share`."""

_FREE: Final = 2
"""So many questions of a cell may have the same answer, whatever others have."""

_PRIOR: Final = 5.0
"""So many questions of a set of choices are expected to have the answers that all questions have."""

_SOUGHT: Final = 4
"""So many times the options that come first are sought before all are put in order."""

_WORTH: Final = 0.1
"""An aim is met where at least this share of what could be chosen stays."""


@dataclass(frozen=True, slots=True)
class Option:
    """A candidate with one of its sets of choices.

    row: of the pool; answer: its text, or the number of its bin; cell: the action words that its question states, with
    the bins of its waits; set: the texts of its choices, sorted, none where the pool holds no sets; order: decides
    between options of one cell and set, and begins with the number of the set among the candidate's own.
    """

    row: int
    subject: Subject
    answer: str | int
    cell: tuple[str, tuple[int, ...]]
    set: tuple[str, ...]
    order: tuple[int, bytes]


_READ: Final = ["answer_text", "times", "sequence", "target_track", "read_frames", "event", "stated", "key", "sets"]


def _options(table: pa.Table, rows: Sequence[int], name: str, seed: int) -> Iterator[Option]:
    """The options of some rows, all of one form."""
    form = TEMPLATES[name]
    mode, read = form.spec.mode, form.spec.read
    # One of each is held, not one per option.
    known: dict[Any, Any] = {}
    for row, line in zip(rows, table.select(_READ).take(pa.array(rows)).to_pylist(), strict=True):
        times, answer = line["times"], line["answer_text"]
        person = line["sequence"], line["target_track"]
        subject = Subject(person, form.name, tuple(line["read_frames"]), line["event"])
        bin_or_text = answer if MODES[mode].is_choice else answer_bin(mode, answer, times, read)
        cell = " | ".join(line["stated"]), tuple(wait_bin(time - times[0]) for time in times[1:])
        cell = known.setdefault(cell, cell)
        drawn = hashlib.sha256(f"{seed} {line['key']}".encode()).digest()
        sets = [tuple(sorted(choices.texts)) for choices in map(_CHOICES.decode, line["sets"] or ())] or [()]
        for number, texts in enumerate(sets):
            yield Option(row, subject, bin_or_text, cell, known.setdefault(texts, texts), (number, drawn))


class Form:
    """The candidates of one form of a template, and the options that are chosen of them, in the order of choice."""

    def __init__(self, table: pa.Table, rows: Sequence[int], name: str, taken: Taken, seed: int) -> None:
        self.spec, rules = TEMPLATES[name].spec, taken.rules
        self.taken = taken
        aim = LIMITS.get(self.spec.read) if rules.max_answer_share < 1 else None
        self.limit = aim or Limit(rules.max_answer_share, strict=True)
        self.options = sorted(
            _options(table, rows, name, seed), key=lambda option: (option.cell, option.set, option.order)
        )
        texts = [option.answer for option in self.options]
        self.answers = _dense(texts) if self.limit.strict else np.array(texts, np.int64)
        self.cells = _dense([option.cell for option in self.options])
        self.sets = _dense([option.set for option in self.options])
        self.of_answer = [np.flatnonzero(self.answers == answer) for answer in range(int(self.answers.max()) + 1)]
        self.sizes = np.bincount(self.answers)
        self.blocks = self._blocks(near_frames(TEMPLATES[name].name, rules))
        self.by_cell, self.by_set = (
            np.zeros((int(numbers.max()) + 1, len(self.sizes)), np.int64) for numbers in (self.cells, self.sets)
        )
        """(cells, answers) and (sets, answers): how many are chosen."""
        possible = np.zeros_like(self.by_cell, bool)
        possible[self.cells, self.answers] = True
        self.varieties = possible.sum(axis=1)
        """Per cell, how many different answers its candidates have."""
        self.offers = np.ones_like(self.by_set, bool)
        """(sets, answers): whether an answer is among the choices."""
        for number, option in dict(zip(self.sets.tolist(), self.options, strict=True)).items():
            if option.set:
                self.offers[number] = [choice_text(str(text)) in option.set for text in sorted(set(texts))]
        self.open = np.ones(len(self.options), bool)
        """Whether an option is still to be tried."""
        self.within_sets = len(self.by_set) > 1
        """Whether the limit holds for the answers of each set of choices."""
        self.loose = False
        """Whether the answer may go with the words more often than others do."""
        self.chosen: list[int] = []
        self.ended = False

    @property
    def candidates(self) -> int:
        """How many candidates there are, each with any number of options."""
        return len({option.row for option in self.options})

    def loosen(self) -> None:
        """Level the answers over all questions from now on, and no more in each set of choices and with each word.

        Nothing changes for a form without several sets of choices.
        """
        if self.within_sets:
            self.within_sets, self.loose = False, True

    def shortage(self) -> str | None:
        """Why candidates that no near-duplicate and no cap forbids are left out; None where none are."""
        left = {self.options[number].row: number for number in self.chosen}
        beside = copy.deepcopy(self.taken)
        for number, option in enumerate(self.options):
            if option.row not in left and beside.admits(option.subject):
                beside.add(option.subject)
                left[option.row] = number
        if len(left) == len(self.chosen):
            return None
        names = Counter(self._answer_name(number) for number in left.values())
        counts = ", ".join(f"{name} {count}" for name, count in sorted(names.items(), key=lambda one: -one[1]))
        room = len(self.limit.stay(self.answers[list(left.values())]))
        whose = "two answers side by side" if self.limit.neighbors else "one answer"
        allowed = f"which allow {room} questions with at most {100 * self.limit.share:.0f} % for {whose}"
        fewer = ", and fewer where words and choices may not tell the answer" if room > len(self.chosen) else ""
        return f"{len(left)} candidates are left ({counts}), {allowed}{fewer}"

    def _answer_name(self, number: int) -> str:
        answer = self.options[number].answer
        return answer if isinstance(answer, str) else bin_name(self.spec.mode, self.spec.read, answer)

    def _blocks(self, near: int) -> Ints:
        """Per option, how many of scarcer answers could not be chosen beside it, as they are near-duplicates."""
        of_person: dict[Person, list[int]] = defaultdict(list)
        for number, option in enumerate(self.options):
            of_person[option.subject.person].append(number)
        counts = np.zeros(len(self.options), np.int64)
        for numbers in of_person.values():
            read = np.array([self.options[number].subject.read for number in numbers])
            sizes = self.sizes[self.answers[numbers]]
            close = (np.abs(read[:, None] - read) <= near).all(axis=2)
            counts[numbers] = (close & (sizes < sizes[:, None])).sum(axis=1)
        return counts

    @property
    def spent(self) -> bool:
        """Whether no more can be chosen."""
        return self.ended or not self.open.any()

    def extend(self, more: int) -> int:
        """Choose so many more, or fewer where candidates or the limit on answers end; returns how many."""
        before = len(self.chosen)
        while len(self.chosen) < before + more:
            counts = self.by_cell.sum(axis=0)
            # Every answer in its turn, the scarcest first.
            turns = sorted(range(len(counts)), key=lambda one: (counts[one], self.sizes[one], one))
            if not any(self._choose_one(answer) for answer in turns):
                break
        self._cut()
        return len(self.chosen) - before

    def _choose_one(self, answer: int) -> bool:
        """Choose an option with this answer, if any may still be chosen; returns whether one was."""
        share = self.limit.share
        options = self.of_answer[answer][self.open[self.of_answer[answer]]]
        if self.within_sets:
            # One more than its share is let in, or nothing could be the first of its set.
            level = self.by_set[:, answer] <= share * (self.by_set.sum(axis=1) + 1)
            options = options[level[self.sets[options]]]
        cells, sets = self.cells[options], self.sets[options]
        # How much oftener the answer goes with the words and waits of a cell than the others that could.
        own, total, variety = self.by_cell[:, answer], self.by_cell.sum(axis=1), self.varieties
        excess = own - (total - own) / np.maximum(variety - 1, 1)
        telling = (variety > 1) & (own >= _FREE) & (excess > 0) & (own > share * (total + 1))
        # How often the answer goes with a set of choices, smoothed by how often it goes with any.
        prior = _PRIOR * (self.by_set.sum(axis=0) + 1) / (len(self.chosen) + 1)
        likely = (self.by_set[:, answer] + prior[answer]) / (self.by_set.sum(axis=1) + self.offers @ prior)
        # Processors sum a product in different orders, so that what is equal may not look so: hence the rounding.
        keys = telling[cells], self.blocks[options], likely.round(9)[sets], excess[cells], -variety[cells]
        for place in _ascending(keys):
            option = int(options[place])
            self.open[option] = False
            if self.taken.admits(self.options[option].subject):
                self.taken.add(self.options[option].subject)
                self._count(option, 1)
                self.chosen.append(option)
                return True
        return False

    def _count(self, option: int, step: int) -> None:
        self.by_cell[self.cells[option], self.answers[option]] += step
        self.by_set[self.sets[option], self.answers[option]] += step

    def _give_back(self, option: int) -> None:
        self.chosen.remove(option)
        self.taken.remove(self.options[option].subject)
        self._count(option, -1)
        self.open[option] = True

    def _cut(self) -> None:
        """Drop the chosen questions that exceed the limit on one answer; they may be chosen again."""
        while self.within_sets and self.by_set.max(axis=1).sum() > self.limit.share * len(self.chosen) + 1e-9:
            worst = (self.by_set.max(axis=1) - self.limit.share * self.by_set.sum(axis=1)).argmax()
            answer = self.by_set[worst].argmax()
            self._give_back(
                next(one for one in reversed(self.chosen) if self.sets[one] == worst and self.answers[one] == answer)
            )
        stays = self.limit.stay(self.answers[self.chosen])
        if not self.limit.strict:
            # Turns are even as long as every answer has some left.
            self.ended = not self.open.any()
            if not self.ended or len(stays) < _WORTH * len(self.chosen):
                return
        for option in set(self.chosen) - {self.chosen[number] for number in stays.tolist()}:
            self._give_back(option)


def _ascending(keys: Sequence[npt.NDArray[Any]]) -> Iterator[int]:
    """Row numbers in the order of several columns, the first one first; equal rows as they stand.

    Mostly one of the first is all that is wanted, and least values are found much sooner than an order of all.
    """
    left = np.arange(len(keys[0]))
    for _ in range(_SOUGHT):
        if not len(left):
            return
        least = left
        for key in keys:
            values = key[least]
            least = least[values == values.min()]
        yield from least.tolist()
        left = np.setdiff1d(left, least, assume_unique=True)
    yield from left[np.lexsort([key[left] for key in reversed(keys)])].tolist()


def _dense(values: Sequence[Hashable]) -> Ints:
    """Every value as its place among the distinct ones."""
    place = {value: number for number, value in enumerate(sorted(set(values)))}  # type: ignore[type-var]
    return np.array([place[value] for value in values], np.int64)
