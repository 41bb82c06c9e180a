"""How well the questions can be answered without looking.

A question that its own text answers is a defect. Six guessers that see no image are scored on each template, as
predictions are: a uniform choice; the most frequent answer; the choice that is true most often where it is offered, by
other sequences; the best constant; the best constant offset from a stated time; and a text-only guesser, which for a
question of one sequence gives the commonest answer, in all other sequences, of questions whose text is alike (action
words, choices, waits between stated times in doubling bins). Constants are chosen with hindsight, so the printed share
is the most that such a guesser can score. For spans and viewpoints the constants tried are the template's own answers.
A seventh guesser that learns from all words may join (`learned`).

Forms of a template are checked apart: a guesser tells them apart by their text.
"""

from __future__ import annotations

import functools
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.bins import answer_bin, bin_name, wait_bin
from jrdb_avr.engine.generate.guessers import LabelCounts, Offer
from jrdb_avr.schema.answer_modes import MODES, decode_answer, mode_of, same_answer
from jrdb_avr.schema.answers import Answer, Choice, FrameAnswer, Number, Span, encode_answer
from jrdb_avr.schema.labels import answer_of_choice
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.wording.text import form_of, parse, stated_actions, stated_frames


@dataclass(frozen=True, slots=True)
class QuestionText:
    """The facts that a question's public text states, with its answer."""

    sequence: str
    template: str
    read: str
    mode: str
    choices: tuple[str, ...]
    words: tuple[str, ...]
    times: tuple[int, ...]
    answer: Answer
    form: str = ""
    text: str = ""

    @property
    def chosen(self) -> str:
        """The text of the right choice."""
        assert isinstance(self.answer, Choice)
        return self.choices[self.answer.choice - 1]

    @property
    def waits(self) -> tuple[int, ...]:
        """Bins of the waits from the first stated time."""
        return tuple(wait_bin(time - self.times[0]) for time in self.times[1:])

    @property
    def asks(self) -> str:
        """The kind of answer in a word or two; of a template's forms a count is judged unlike seconds."""
        return "count" if self.read == "count" else MODES[self.mode].asks

    @property
    def bin(self) -> str:
        """The bin of the answer, by which selection balances."""
        answer = encode_answer(self.answer)
        return bin_name(self.mode, self.read, answer_bin(self.mode, answer, self.times, self.read))


def question_texts(questions: pa.Table, answers: pa.Table) -> list[QuestionText]:
    """The questions with their answers, by question id. Raises PlanError for a text that is none of ours."""
    stored = dict(zip(answers["question_id"].to_pylist(), answers["answer"].to_pylist(), strict=True))
    found = []
    for row in sorted(questions.to_pylist(), key=lambda row: row["question_id"]):
        template, plan = parse(row["question"])
        found.append(
            QuestionText(
                row["sequence"],
                row["template"],
                plan.answer.read,
                row["answer_mode"],
                tuple(row["choices"]),
                stated_actions(plan),
                stated_frames(plan),
                decode_answer(row["answer_mode"], stored[row["question_id"]]),
                form_of(template, plan)[0].query,
                row["question"],
            )
        )
    return found


def offers_of(questions: Iterable[QuestionText], counts: LabelCounts) -> list[Offer]:
    """Return what counting guessers know of published questions with choices, as selection computes it.

    Args:
        questions: Questions of one template.
        counts: How common actions are. The frame of a rank is the last time that the text states.

    Returns:
        The choices of each question.
    """
    offers = []
    for question in questions:
        truth = answer_of_choice(question.chosen)
        wrong = tuple(sorted(answer_of_choice(text) for text in question.choices if text != question.chosen))
        ranks = counts.ranks(question.sequence, question.times[-1], truth, wrong)
        offers.append(Offer(question.sequence, truth, wrong, ranks))
    return offers


Guesser = Callable[[Sequence[QuestionText]], float | None]
"""Returns the share of right answers to questions of one form; None where it cannot answer them."""


def blind_check(questions: Sequence[QuestionText], learned: Guesser | None = None) -> list[dict[str, Any]]:
    """One row per form of a template: n, each guesser's share of right answers, the aim, and why it is missed.

    A guesser that does not apply has None, and so has `learned` where none is named (`learned_guesser`). Counts
    have None as aim, and `reason` is None where nothing is above the aim.
    """
    groups: dict[tuple[str, str, str], list[QuestionText]] = defaultdict(list)
    for question in questions:
        groups[question.template, question.form, question.asks].append(question)
    return [
        {"template": template, "form": form or template, "asks": asks, **_check(group, learned)}
        for (template, form, asks), group in sorted(groups.items())
    ]


def _check(group: list[QuestionText], learned: Guesser | None) -> dict[str, Any]:
    mode, n = MODES[group[0].mode], len(group)
    scores: dict[str, float | None] = dict.fromkeys(("uniform", "most_frequent", "by_choice", "constant", "offset"))
    if "uniform" in mode.guessers:
        scores["uniform"] = sum(1 / len(q.choices) for q in group) / n
        scores["most_frequent"] = max(Counter(question.chosen for question in group).values()) / n
        scores["by_choice"] = _by_choice(group)
    if "constant" in mode.guessers:
        scores["constant"] = _best(group, [0] * n)
    if "offset" in mode.guessers:
        positions = range(min(len(q.times) for q in group))
        scores["offset"] = max(_best(group, [q.times[position] for q in group]) for position in positions)
    scores["text_only"] = _text_only(group)
    scores["learned"] = None if learned is None else learned(group)
    aim = None if group[0].read == "count" else mode.aim
    above = [name for name, score in scores.items() if score is not None and aim is not None and score > aim]
    within = None if aim is None else not above
    return {"n": n, **scores, "aim": aim, "within_aim": within, "reason": _reason(group, above) if above else None}


FEW: Final = 30
"""With fewer questions a share of right answers is not reliable."""


def _reason(group: Sequence[QuestionText], above: Sequence[str]) -> str:
    """Explain why guessers score above the aim: which answers are too similar."""
    n = len(group)
    parts = [f"only {n} question{'s' * (n > 1)}, one is {100 / n:.0f} %"] if n < FEW else []
    if set(above) - {"by_choice", "text_only", "learned"}:
        choice = MODES[group[0].mode].is_choice
        commonest = Counter(question.chosen if choice else question.bin for question in group)
        name, count = min(commonest.items(), key=lambda item: (-item[1], item[0]))
        what = f"are {name!r}" if choice else f"lie in {name} s"
        parts.append(f"{count} of {n} answers {what}, and too few others are left to level them")
    if "by_choice" in above:
        parts.append("too few poses are ever true that do not overlap the others, so some choices are true oftener")
    if "text_only" in above:
        parts.append("questions with the same words and waits have the same answers in other sequences")
    if "learned" in above:
        parts.append("words, choices and waits go with the same answers in other sequences")
    return "; ".join(parts)


def _by_choice(group: Sequence[QuestionText]) -> float | None:
    """The share of right answers of whoever takes the choice that is true most often where it is offered.

    How often that is, the guesser knows from other sequences; None where there are none.
    """
    offered, true = (Counter[tuple[str, str]]() for _ in range(2))
    for question in group:
        for place in ("", question.sequence):
            offered.update((place, choice) for choice in question.choices)
            true[place, question.chosen] += 1
    if len({question.sequence for question in group}) < 2:
        return None

    def rate(question: QuestionText, choice: str) -> float:
        counts = [count["", choice] - count[question.sequence, choice] for count in (true, offered)]
        return (counts[0] + 1) / (counts[1] + len(question.choices))

    guesses = (max(q.choices, key=lambda choice: (rate(q, choice), choice)) for q in group)
    return sum(guess == question.chosen for guess, question in zip(guesses, group, strict=True)) / len(group)


# -- constants ----------------------------------------------------------------------------------------------------


def _best(group: Sequence[QuestionText], bases: Sequence[int]) -> float:
    """The best score of one answer for all, counted from a frame of each question; 0 for a constant."""
    guess = best_guess([_moved(q.answer, -base) for q, base in zip(group, bases, strict=True)])
    return sum(same_answer(_moved(guess, base), q.answer) for q, base in zip(group, bases, strict=True)) / len(group)


def best_guess(relative: Sequence[Answer]) -> Answer:
    """The answer that is right for the most of these; the smallest of equals."""
    match relative[0]:
        case FrameAnswer():
            # A window that holds the most answers can begin at one of them.
            frames = np.sort([a.frame for a in relative if isinstance(a, FrameAnswer)])
            window = round(FPS)
            held = np.searchsorted(frames, frames + 2 * window, "right") - np.arange(len(frames))
            return FrameAnswer(int(frames[held.argmax()]) + window)
        case Number():
            values = np.sort([a.value for a in relative if isinstance(a, Number)])
            held = np.searchsorted(values, values * 4, "right") - np.arange(len(values))
            return Number(float(values[held.argmax()]) * 2)
    distinct = sorted(set(relative), key=repr)
    if isinstance(relative[0], Span):
        counts = _matching_spans(distinct, relative)
    else:
        counts = [sum(same_answer(guess, answer) for answer in relative) for guess in distinct]
    return distinct[int(np.argmax(counts))]


def _matching_spans(guesses: Sequence[Answer], answers: Sequence[Answer]) -> list[int]:
    """How many spans each guess scores against, by `same_answer`; of thousands, one pair at a time takes seconds."""
    starts, ends = np.array([(a.start_frame, a.end_frame + 1) for a in answers if isinstance(a, Span)]).T
    counts = []
    for guess in guesses:
        assert isinstance(guess, Span)
        both = np.minimum(ends, guess.end_frame + 1) - np.maximum(starts, guess.start_frame)
        either = ends - starts + guess.end_frame + 1 - guess.start_frame - both
        counts.append(int(np.count_nonzero((both > 0) & (2 * both >= either))))
    return counts


def _moved(answer: Answer, frames: int) -> Answer:
    """An answer with its frames counted from another one."""
    frames_of = {name: getattr(answer, name) for name, kind in mode_of(answer).fields if kind == "frame"}
    return msgspec.structs.replace(answer, **{name: frame + frames for name, frame in frames_of.items()})


# -- the text-only guesser ----------------------------------------------------------------------------------------

_ALIKE: Final[tuple[Callable[[QuestionText], Hashable], ...]] = (
    lambda q: (q.words, tuple(sorted(q.choices)), q.waits),
    lambda q: (q.words, q.waits),
    lambda q: q.words,
    lambda q: q.waits,
    lambda q: None,
)
"""Features by which two texts are alike, strictest first; the next applies where no other sequence matches."""


def _text_only(group: Sequence[QuestionText]) -> float:
    pools: dict[tuple[int, Hashable], list[QuestionText]] = defaultdict(list)
    for question in group:
        for level, alike in enumerate(_ALIKE):
            pools[level, alike(question)].append(question)

    @functools.cache
    def learned(sequence: str, level: int, key: Hashable) -> Counter[str] | Answer | None:
        others = [question for question in pools[level, key] if question.sequence != sequence]
        if MODES[group[0].mode].is_choice:
            return Counter(question.chosen for question in others)
        return best_guess([_moved(q.answer, -q.times[0]) for q in others]) if others else None

    def score(question: QuestionText) -> float:
        for level, alike in enumerate(_ALIKE):
            guess = learned(question.sequence, level, alike(question))
            if isinstance(guess, Counter):
                if offered := [text for text in question.choices if guess[text]]:
                    return float(min(offered, key=lambda text: (-guess[text], text)) == question.chosen)
            elif guess is not None:
                return float(same_answer(_moved(guess, question.times[0]), question.answer))
        return 1 / len(question.choices) if question.choices else 0.0

    return sum(map(score, group)) / len(group)
