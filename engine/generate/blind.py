"""The blind check: how well the questions can be answered without looking.

A question that its own text answers is a defect. Guessers that see no image are scored on each template, as predictions
are. The simple guessers are a uniform choice, the best constant, and the best constant offset from a stated time.
Constants are chosen with hindsight, so their score is the most that such a guesser can reach. Counting guessers know
how often each choice is true in other sequences (`guessers`). Further guessers learn from all words (`learned`) or know
the store's people (`scene_guessers`).

The forms of a template are checked separately, because their texts differ.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.bins import answer_bin, bin_name
from jrdb_avr.engine.generate.guessers import COUNTING, LabelCounts, Offer, guesser_scores
from jrdb_avr.schema.answer_modes import MODES, decode_answer, mode_of, same_answer
from jrdb_avr.schema.answers import Answer, Choice, FrameAnswer, Number, encode_answer
from jrdb_avr.schema.labels import answer_of_choice
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.templates import Template
from jrdb_avr.schema.wording.text import actions_of, form_of, parse, stated_frames

INFORMATION: Final = ("frame", "least label", "least set", "least pair")
"""Counting guessers that have no aim."""

GUESSERS: Final = (
    *("uniform", "constant", "offset", *COUNTING, "people", "logistic", "boosting", "other_store"),
    *INFORMATION,
)
"""Guessers of answers, in the order of their columns."""

BOXES: Final = ("largest", "best_box")
"""Guessers of evidence boxes."""

_TRIED: Final = 500
"""Maximum number of answers that are tried as a constant. A benchmark has fewer in a template, a training set more."""

FEW: Final = 30
"""With fewer questions, a share of right answers is not reliable."""


@dataclass(frozen=True, slots=True)
class QuestionText:
    """The facts that a question's public text states, with its answer.

    Attributes:
        question_id: The id of the question.
        sequence: Name of the sequence.
        form: Form of the template.
        choices: Texts of the choices.
        described: Actions that the text states of the target, sorted.
        times: Stated frames. The first one is the time of the description.
        answer: The true answer.
        text: The text.
        twin: The key that the question shares with its time twin, or None.
    """

    question_id: str
    sequence: str
    form: Template
    choices: tuple[str, ...]
    described: tuple[str, ...]
    times: tuple[int, ...]
    answer: Answer
    text: str = ""
    twin: str | None = None

    @property
    def chosen(self) -> str:
        """The text of the right choice."""
        assert isinstance(self.answer, Choice)
        return self.choices[self.answer.choice - 1]

    @property
    def asks(self) -> str:
        """The kind of answer in a word or two. A count and seconds are different kinds."""
        return "count" if self.form.spec.read == "count" else MODES[self.form.spec.mode].asks

    @property
    def bin(self) -> str:
        """The bin of the answer. Selection balances the bins."""
        spec, answer = self.form.spec, encode_answer(self.answer)
        return bin_name(spec.mode, spec.read, answer_bin(spec.mode, answer, self.times, spec.read))


def question_texts(questions: pa.Table, answers: pa.Table) -> list[QuestionText]:
    """Read the texts of questions.

    Args:
        questions: Rows of the table `questions`.
        answers: Rows of the table `answers`, in any order.

    Returns:
        The facts of each text, by question id.

    Raises:
        PlanError: If this program did not write a text.
    """
    stored = {row["question_id"]: row for row in answers.to_pylist()}
    texts = []
    for row in sorted(questions.to_pylist(), key=lambda row: row["question_id"]):
        template, plan = parse(row["question"])
        conditions = (condition for node in plan.nodes if node.id == plan.target for condition in node.conditions)
        texts.append(
            QuestionText(
                row["question_id"],
                row["sequence"],
                form_of(template, plan)[0],
                tuple(row["choices"]),
                tuple(sorted({word for condition in conditions for word in actions_of(condition)})),
                stated_frames(plan),
                decode_answer(row["answer_mode"], stored[row["question_id"]]["answer"]),
                row["question"],
                stored[row["question_id"]].get("twin_id"),
            )
        )
    return texts


Chances = Sequence[float]
"""For each question, the probability that a guesser is right."""

Guesser = Callable[[Sequence[QuestionText]], Mapping[str, Chances]]
"""Function from the questions of one form to the scores of those guessers that apply, by their names."""


def score_forms(
    questions: Iterable[QuestionText], guessers: Sequence[Guesser]
) -> Iterator[tuple[list[QuestionText], dict[str, Chances]]]:
    """Score blind guessers on each form of a template.

    Args:
        questions: The questions.
        guessers: Guessers beside the simple ones.

    Yields:
        The questions of a form, with the scores of each guesser that applies, by its name.
    """
    groups: dict[tuple[str, str], list[QuestionText]] = defaultdict(list)
    for question in questions:
        groups[question.form.name, question.form.query].append(question)
    for _, group in sorted(groups.items()):
        yield group, {name: of for guesser in (_simple, *guessers) for name, of in guesser(group).items()}


def blind_check(questions: Iterable[QuestionText], guessers: Sequence[Guesser]) -> list[dict[str, Any]]:
    """Compute the table of blind guessers, by the forms of templates.

    Args:
        questions: The questions.
        guessers: Guessers beside the simple ones.

    Returns:
        One row per form. It has n, the share of right answers of each guesser of `GUESSERS`, the share of right boxes
        of each guesser of `BOXES`, and the aim. A guesser that does not apply has None. The reason names the guessers
        of answers above the aim, or is None. `combined` is the share of questions that the best guesser of answers and
        the best guesser of boxes both have right. Counts of people have no aim. If a form has time twins, a second row,
        "FORM, two twins", has their number of pairs as n and the shares of pairs with both right.
    """
    rows = []
    for group, scores in score_forms(questions, guessers):
        head = {"template": group[0].form.name, "form": group[0].form.query, "asks": group[0].asks}
        aim = None if group[0].asks == "count" else MODES[group[0].form.spec.mode].aim
        rows.append(head | _shares(scores, aim))
        numbers = [index for index, question in sorted(enumerate(group), key=lambda entry: entry[1].twin or "")]
        pairs = [pair for pair in pairwise(numbers) if group[pair[0]].twin == group[pair[1]].twin is not None]
        if pairs:
            both = {name: [of[first] * of[second] for first, second in pairs] for name, of in scores.items()}
            rows.append(head | {"form": f"{head['form']}, two twins"} | _shares(both, None))
    return rows


def _shares(scores: Mapping[str, Chances], aim: float | None) -> dict[str, Any]:
    """Return the columns of a row of `blind_check` for the scores of all guessers."""
    shares = {name: sum(of) / len(of) for name, of in scores.items()}
    n = len(next(iter(scores.values())))
    answers = [name for name in scores if name not in (*INFORMATION, *BOXES)]
    if boxes := [name for name in scores if name in BOXES]:
        best = (scores[max(names, key=shares.__getitem__)] for names in (answers, boxes))
        shares["combined"] = sum(answer * box for answer, box in zip(*best, strict=True)) / n
    above = [f"{name} {100 * shares[name]:.0f} %" for name in answers if aim is not None and shares[name] > aim]
    columns = dict.fromkeys((*GUESSERS, *BOXES, "combined"))
    return {"n": n, **columns, **shares, "aim": aim, "reason": ", ".join(above) or None}


def _simple(group: Sequence[QuestionText]) -> dict[str, Chances]:
    """Return the scores of the simple guessers."""
    guessers = MODES[group[0].form.spec.mode].guessers
    scores: dict[str, Chances] = {}
    if "uniform" in guessers:
        scores["uniform"] = [1 / len(question.choices) for question in group]
        counts = Counter(question.chosen for question in group)
        commonest = min(counts, key=lambda text: (-counts[text], text))
        scores["constant"] = [float(question.chosen == commonest) for question in group]
    elif "constant" in guessers:
        scores["constant"] = _hits(group, [0] * len(group))
    if "offset" in guessers:
        positions = range(min(len(question.times) for question in group))
        scores["offset"] = max((_hits(group, [q.times[at] for q in group]) for at in positions), key=sum)
    return scores


def counting_guesser(counts: LabelCounts | None = None) -> Guesser:
    """Return the counting guessers of choices, as selection computes them.

    Args:
        counts: How common actions are. The frame of a rank is the last time that the text states. None leaves out the
            guessers that go by the commonest choice.

    Returns:
        The function from questions to the scores of the guessers.
    """

    def guess(group: Sequence[QuestionText]) -> Mapping[str, Chances]:
        scores = guesser_scores(offers_of(group, counts)) if group[0].choices else {}
        return {name: list(map(float, of)) for name, of in scores.items()}

    return guess


def offers_of(questions: Iterable[QuestionText], counts: LabelCounts | None = None) -> list[Offer]:
    """Return what counting guessers know of published questions with choices.

    Args:
        questions: Questions of one template.
        counts: How common actions are, or None.

    Returns:
        The choices of each question.
    """
    offers = []
    for question in questions:
        truth = answer_of_choice(question.chosen)
        wrong = tuple(sorted(answer_of_choice(text) for text in question.choices if text != question.chosen))
        ranks = () if counts is None else counts.ranks(question.sequence, question.times[-1], truth, wrong)
        offers.append(Offer(question.sequence, truth, wrong, ranks))
    return offers


# -- constants ----------------------------------------------------------------------------------------------------


def _hits(group: Sequence[QuestionText], bases: Sequence[int]) -> list[float]:
    """Return the scores of the best answer for all, counted from a frame of each question; 0 for a constant."""
    guess = best_guess([_moved(q.answer, -base) for q, base in zip(group, bases, strict=True)])
    return [float(same_answer(_moved(guess, base), q.answer)) for q, base in zip(group, bases, strict=True)]


def best_guess(relative: Sequence[Answer]) -> Answer:
    """Find the answer that is right for the most questions.

    Args:
        relative: The true answers, with frames counted from a frame of each question.

    Returns:
        The answer, the first one of equals. At most `_TRIED` true answers are tried. If answers are frames or numbers,
        a true answer is tried as the lower limit of what counts as right, because the best limits begin at one.
    """
    distinct = sorted(set(relative), key=repr)
    tried: list[Answer] = distinct[:: -(-len(distinct) // _TRIED)]
    if isinstance(tried[0], FrameAnswer):
        tried = [_moved(answer, round(FPS)) for answer in tried]
    elif isinstance(tried[0], Number):
        tried = [Number(2 * answer.value) for answer in tried if isinstance(answer, Number)]
    counts = [sum(same_answer(guess, answer) for answer in relative) for guess in tried]
    return tried[int(np.argmax(counts))]


def _moved(answer: Answer, frames: int) -> Answer:
    """Return an answer with its frames moved."""
    frames_of = {name: getattr(answer, name) for name, kind in mode_of(answer).fields if kind == "frame"}
    return msgspec.structs.replace(answer, **{name: frame + frames for name, frame in frames_of.items()})
