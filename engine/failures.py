"""How a method fails: which perturbed reading its wrong choices are true of, and why its boxes do not score.

A question whose box does not score has exactly one cause, the first that fits:

    no box                          none was given, or it could not be read, or the question ended in an error
    never looked there              no look of the run shows half of the target's width in any frame
    frame where the target is absent  the target has no box in the frame that was given
    right person, loose box         the box overlaps the target more than it does anybody else
    wrong person                    it overlaps somebody else more
    nobody                          it overlaps nobody's box
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.panorama import CROP, WIDTH

from .judged import Facts, Floats, Ints, Judged, share
from .scoring import MOST_FRAMES, Truth, box_ious, frame_key
from .tracing import look_asked, look_left

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


def wrong_choice_rows(store: Store, runs: Sequence[Judged]) -> list[dict[str, Any]]:
    """Per run: the perturbation behind each wrong choice that was made, in percent of the wrong choices."""
    answers = store.questions("answers").select(["question_id", "distractors"])
    distractors = dict(zip(answers["question_id"].to_pylist(), answers["distractors"].to_pylist(), strict=True))
    rows = []
    for run in runs:
        found = Counter(_perturbation(distractors[name], number) for name, number in _wrong_choices(run))
        total = found.total()
        for name, times in sorted(found.items(), key=lambda item: (-item[1], item[0])):
            head = {"run": run.manifest.run_id, "perturbation": name}
            rows.append(head | {"wrong_choices": total, "times": times, "percent": share(times, total)})
    return rows


def _wrong_choices(run: Judged) -> Iterator[tuple[str, int]]:
    asked = pa.array(run.manifest.question_ids, pa.string())
    wrong = asked.filter(pa.array(run.scores[:, 0] == 0))
    among = run.predictions.filter(pc.is_in(run.predictions["question_id"], value_set=wrong))
    for name, text in zip(among["question_id"].to_pylist(), among["answer"].to_pylist(), strict=True):
        number = _choice(text)
        if number is not None:
            yield name, number


def _choice(text: str | None) -> int | None:
    try:
        answer = msgspec.json.decode(text or "null")
    except (msgspec.DecodeError, UnicodeEncodeError):
        return None
    number = answer.get("choice") if isinstance(answer, dict) else None
    return number if isinstance(number, int) else None


def _perturbation(distractors: str, number: int) -> str:
    """The perturbation that yields a choice: its kind, without what it left out."""
    texts = msgspec.json.decode(distractors, type=list[str | None])
    text = texts[number - 1] if 1 <= number <= len(texts) else None
    return NONE_RECORDED if text is None else text.partition(" without ")[0]


# -- boxes that do not score ------------------------------------------------------------------------------------------


def evidence_failure_rows(store: Store, truth: Truth, facts: Facts, runs: Sequence[Judged]) -> list[dict[str, Any]]:
    """Per run and cause: how many boxes do not score, in percent of the questions asked."""
    people = _People(store)
    rows = []
    for run in runs:
        causes = evidence_causes(store, truth, facts, run, people)
        found = Counter(cause for cause in causes if cause)
        for cause in CAUSES:
            head = {"run": run.manifest.run_id, "cause": cause, "n": run.n}
            rows.append(head | {"times": found[cause], "percent": share(found[cause], run.n)})
    return rows


def evidence_causes(store: Store, truth: Truth, facts: Facts, run: Judged, people: _People | None = None) -> list[str]:
    """The cause per question asked, in the order asked; "" where the box scores."""
    people = people or _People(store)
    shown = _shown(store, truth, run)
    given = {row["question_id"]: row for row in run.predictions.to_pylist()}
    sequences = facts.texts["sequence"][run.rows].tolist()
    causes = []
    for place, (name, sequence) in enumerate(zip(run.manifest.question_ids, sequences, strict=True)):
        if run.scores[place, 1]:
            causes.append("")
            continue
        frames, boxes = _target(truth, int(run.rows[place]))
        causes.append(_cause(given.get(name), frames, boxes, bool(shown[place]), people, sequence))
    return causes


def _cause(
    row: Mapping[str, Any] | None,
    frames: Ints,
    boxes: Floats,
    shown: bool,
    people: _People,
    sequence: str,
) -> str:
    if row is None or row["status"] == "error" or row["evidence_frame"] is None or row["evidence_w"] is None:
        return CAUSES[0]
    if not shown:
        return CAUSES[1]
    frame = row["evidence_frame"]
    at = np.flatnonzero(frames == frame)
    if not len(at):
        return CAUSES[2]
    box = np.array([[row[f"evidence_{key}"] for key in "xywh"]], np.float64)
    own = float(box_ious(box, boxes[at])[0])
    others = people.at(sequence, frame)
    best = float(box_ious(np.repeat(box, len(others), axis=0), others).max(initial=0.0))
    if own == best == 0.0:
        return CAUSES[5]
    # The target is one of the people, so nobody overlaps the box more where these are equal.
    return CAUSES[3] if own >= best else CAUSES[4]


def _target(truth: Truth, row: int) -> tuple[Ints, Floats]:
    """Frames and boxes of a question's target."""
    first, last = np.searchsorted(truth.keys, [frame_key(row, 0), frame_key(row + 1, 0)])
    return truth.keys[first:last] - frame_key(row, 0), truth.boxes[first:last]


def _shown(store: Store, truth: Truth, run: Judged) -> npt.NDArray[np.bool_]:
    """For each question asked, whether some look of the run's transcript shows enough of the target."""
    found = np.zeros(run.n, dtype=bool)
    steps = read_table(store.run_path(run.manifest.run_id) / "steps.parquet")
    steps = steps.filter(pc.equal(steps["kind"], "observe"))
    place = pc.index_in(steps["question_id"], value_set=pa.array(run.manifest.question_ids, pa.string()))
    looks = np.concatenate([_distinct(steps["request"], _asked, 2), _distinct(steps["response"], _left, 1)], axis=1)
    looks = np.concatenate([pc.fill_null(place, -1).to_numpy().astype(np.float64)[:, None], looks], axis=1)
    looks = looks[np.isfinite(looks).all(axis=1) & (looks[:, 0] >= 0)]
    if not len(looks) or not len(truth.keys):
        return found
    asked, frame, width, left = looks.T
    asked = asked.astype(np.int64)
    key = frame_key(run.rows[asked], frame.astype(np.int64))
    at = np.minimum(np.searchsorted(truth.keys, key), len(truth.keys) - 1)
    x, w = truth.boxes[at, 0], truth.boxes[at, 2]
    # Columns from the look's left edge on; a box may begin before it and reach in, also over the seam.
    start = (x - np.where(width < WIDTH, left, 0)) % WIDTH
    seen = np.maximum(0, np.minimum(start + w, width) - start) + np.maximum(0, np.minimum(start + w - WIDTH, width))
    found[asked[(truth.keys[at] == key) & (seen >= _SHOWN * w)]] = True
    return found


def _distinct(texts: pa.ChunkedArray, read: Callable[[str], tuple[float, ...]], columns: int) -> Floats:
    """Numbers read from each text, (n, columns); each distinct text is read once, as runs look alike at much."""
    encoded = texts.combine_chunks().dictionary_encode()
    numbers = np.array([read(text) for text in encoded.dictionary.to_pylist()], np.float64).reshape(-1, columns)
    found: Floats = numbers[encoded.indices.to_numpy()]
    return found


def _asked(request: str) -> tuple[float, float]:
    """Frame and width of a look; not a number where it cannot be told."""
    asked = look_asked(request)
    if asked is None or not 0 <= asked[0] < MOST_FRAMES:
        return math.nan, math.nan
    return asked[0], WIDTH if asked[1] is None else CROP


def _left(response: str) -> tuple[float]:
    left = look_left(response)
    return (math.nan if left is None else left % WIDTH,)


class _People:
    """Everybody's boxes, read a sequence at a time."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._read: dict[str, tuple[Ints, Floats]] = {}

    def at(self, sequence: str, frame: int) -> Floats:
        """Boxes (n, 4) at a frame."""
        if sequence not in self._read:
            table = self._store.interval("sightings", sequence).select(["frame", "x", "y", "w", "h"])
            frames = table["frame"].to_numpy().astype(np.int64)
            boxes = np.stack([table[key].to_numpy() for key in "xywh"], axis=1).astype(np.float64)
            order = np.argsort(frames, kind="stable")
            self._read[sequence] = frames[order], boxes[order]
        frames, boxes = self._read[sequence]
        first, last = np.searchsorted(frames, [frame, frame + 1])
        return boxes[first:last]
