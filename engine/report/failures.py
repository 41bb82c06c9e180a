"""How a method fails: the perturbed question that its wrong choices answer, and why its boxes do not score.

A question whose box does not score has exactly one cause, the first that fits:

    no box                          the prediction has none, or an unreadable one, or ended in an error
    never looked there              no look of the run includes half of the target's width in any frame
    frame where the target is absent  the target has no box in the frame of the prediction
    right person, loose box         the box overlaps the target more than anybody else
    wrong person                    it overlaps somebody else more
    nobody                          it overlaps nobody's box
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.scored_runs import QuestionIndex, ScoredRun, percent_of
from jrdb_avr.engine.report.scoring import (
    Truth,
    align_predictions,
    box_ious,
    frame_key,
    predicted_boxes,
    read_answer,
    target_boxes,
)
from jrdb_avr.engine.report.traces import look_shown
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.panorama import CROP, WIDTH

CAUSES: Final = (
    "no box",
    "never looked there",
    "frame where the target is absent",
    "right person, loose box",
    "wrong person",
    "nobody",
)

NONE_RECORDED: Final = "none recorded"

_SHOWN: Final = 0.5
"""Share of the target's width that a look must show."""


# -- wrong choices ----------------------------------------------------------------------------------------------------


def wrong_choice_rows(store: Store, index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    """Per run: the perturbation behind each wrong choice, in percent of the wrong choices."""
    answers = store.questions("answers", ["question_id", "distractors"])
    known = answers["distractors"].take(pc.index_in(index.ids, value_set=answers["question_id"].combine_chunks()))
    perturbations = [_perturbations(text) for text in known.to_pylist()]
    modes = index.labels["answer_mode"]
    with_choices = np.array(modes.names)[modes.numbers] == "multiple_choice"
    rows = []
    for run in runs:
        aligned, judged = align_predictions(run.manifest.question_ids, run.predictions)
        wrong = judged & (run.scores[:, 0] == 0) & with_choices[run.rows]
        choices = map(_choice, aligned["answer"].filter(pa.array(wrong)).to_pylist())
        found = Counter(
            perturbations[question].get(choice, NONE_RECORDED)
            for question, choice in zip(run.rows[wrong].tolist(), choices, strict=True)
            if choice is not None
        )
        for name, times in sorted(found.items(), key=lambda item: (-item[1], item[0])):
            head = {"run": run.manifest.run_id, "perturbation": name, "wrong_choices": found.total(), "times": times}
            rows.append(head | {"percent": percent_of(times, found.total())})
    return rows


@functools.lru_cache(maxsize=1 << 12)
def _choice(text: str | None) -> int | None:
    answer = read_answer("multiple_choice", text)
    return answer.choice if isinstance(answer, Choice) else None


def _perturbations(distractors: str) -> dict[int, str]:
    """By the number of a choice, the kind of the perturbation that yields it."""
    texts = msgspec.json.decode(distractors, type=list[str | None])
    return {number: text.partition(" without ")[0] for number, text in enumerate(texts, 1) if text is not None}


# -- boxes that do not score ------------------------------------------------------------------------------------------

SCORES_AT: Final = -1
"""In place of a cause where the box scores."""


def evidence_failure_rows(
    store: Store, truth: Truth, index: QuestionIndex, runs: Sequence[ScoredRun]
) -> list[dict[str, Any]]:
    """Per run and cause: how many boxes do not score, in percent of the questions."""
    people = people_boxes(store, index)
    rows = []
    for run in runs:
        causes = evidence_causes(store, truth, index, run, people)
        found = np.bincount(causes[causes != SCORES_AT], minlength=len(CAUSES)).tolist()
        for cause, times in zip(CAUSES, found, strict=True):
            head = {"run": run.manifest.run_id, "cause": cause, "n": run.n}
            rows.append(head | {"times": times, "percent": percent_of(times, run.n)})
    return rows


def evidence_causes(
    store: Store, truth: Truth, index: QuestionIndex, run: ScoredRun, people: tuple[Ints, Floats]
) -> Ints:
    """The place of each question's cause in `CAUSES`, `SCORES_AT` where its box scores."""
    aligned, judged = align_predictions(run.manifest.question_ids, run.predictions)
    frame, box, boxed = predicted_boxes(aligned)
    present, target = target_boxes(truth, run.rows, frame)
    own = np.where(present, box_ious(box, target), 0.0)
    scores = run.scores[:, 1] == 1
    # Looks and other people matter only where no earlier cause fits.
    shown = _shown(store, truth, run, ~scores & judged & boxed)
    rows = np.flatnonzero(~scores & judged & boxed & shown & present)
    best = np.zeros(run.n)
    best[rows] = _best_ious(people, frame_key(index.labels["sequence"].numbers[run.rows], frame)[rows], box[rows])
    causes = np.select(
        [
            scores,
            ~(judged & boxed),
            ~shown,
            ~present,
            # The target is one of the people, so nobody overlaps the box more where these are equal.
            (own >= best) & (own > 0),
            best > 0,
        ],
        [SCORES_AT, 0, 1, 2, 3, 4],
        5,
    )
    return causes.astype(np.int64)


def people_boxes(store: Store, index: QuestionIndex) -> tuple[Ints, Floats]:
    """Everybody's boxes (n, 4), in the order of their keys: sequence, as the index number them, and frame."""
    keys, boxes = [np.zeros(0, np.int64)], [np.zeros((0, 4))]
    for number, sequence in enumerate(index.labels["sequence"].names):
        table = store.interval("sightings", sequence, ["frame", *"xywh"])
        keys.append(frame_key(number, table["frame"].to_numpy().astype(np.int64)))
        boxes.append(np.stack([table[key].to_numpy() for key in "xywh"], axis=1).astype(np.float64))
    key = np.concatenate(keys)
    order = np.argsort(key, kind="stable")
    return key[order], np.concatenate(boxes)[order]


def _best_ious(people: tuple[Ints, Floats], keys: Ints, boxes: Floats) -> Floats:
    """The IoU of each box with the person, of those at its key, that it overlaps most."""
    first, last = (np.searchsorted(people[0], keys, side) for side in ("left", "right"))
    count = last - first
    row = np.repeat(np.arange(len(keys)), count)
    # Each box beside every person at its key: their rows are first, first + 1, ... of each.
    person = np.arange(len(row)) - np.repeat(np.cumsum(count) - count - first, count)
    best = np.zeros(len(keys))
    np.maximum.at(best, row, box_ious(boxes[row], people[1][person]))
    return best


def _shown(store: Store, truth: Truth, run: ScoredRun, among: Bools) -> Bools:
    """For each question of those `among`, whether some look of the run's transcript shows enough of the target."""
    found = np.zeros(run.n, dtype=bool)
    # Requests hold whole conversations: the looks stand in the responses, a hundredth of the size.
    steps = read_table(store.run_path(run.manifest.run_id) / "steps.parquet", ["question_id", "kind", "response"])
    rows = pc.index_in(steps["question_id"], value_set=pa.array(run.manifest.question_ids, pa.string()))
    wanted = pc.and_(pc.equal(steps["kind"], "observe"), pc.take(pa.array(among), rows))
    place = rows.filter(wanted).to_numpy()
    looks = _looks(steps["response"].filter(wanted))
    known = np.isfinite(looks).all(axis=1)
    rows, (frame, left, width) = place[known], looks[known].T
    present, box = target_boxes(truth, run.rows[rows], frame.astype(np.int64))
    x, w = box[:, 0], box[:, 2]
    # Columns from the look's left edge on; a box may begin before it and reach in, also over the seam.
    start = (x - left) % WIDTH
    seen = np.maximum(0, np.minimum(start + w, width) - start) + np.maximum(0, np.minimum(start + w - WIDTH, width))
    found[rows[present & (seen >= _SHOWN * w)]] = True
    return found


def _looks(responses: pa.ChunkedArray) -> Floats:
    """Frame, left column and width of each look, (n, 3); NaN where the response cannot be read.

    Each distinct text is read once, as questions and runs look alike at much.
    """
    encoded = responses.combine_chunks().dictionary_encode()
    read = chain.from_iterable(_look(text) for text in encoded.dictionary.to_pylist())
    numbers = np.fromiter(read, np.float64).reshape(-1, 3)
    found: Floats = numbers[encoded.indices.to_numpy()]
    return found


@functools.lru_cache(maxsize=1 << 18)
def _look(response: str) -> tuple[float, float, float]:
    shown = look_shown(response)
    if shown is None:
        return math.nan, math.nan, math.nan
    frame, angle, left = shown
    return frame, left, WIDTH if angle is None else CROP
