"""Balance: no answer so common that it could be guessed, as far as the candidates allow.

The candidates of one template and one kind of read are levelled by their answers (or the bins that hold them), within
cells of questions that read alike, and put into an order of which every beginning is balanced like the whole.

Bins of answers that are times or numbers, and of the waits that a question states.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Number, Span, decode_answer
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.rules import FPS, Rules, frames

OFFSET_EDGES_S: Final = (3.0, 6.0, 10.0, 15.0, 21.0)
GAP_EDGES_S: Final = (5.0, 10.0, 20.0, 40.0)


def wait_bin(wait: int) -> int:
    """Bin of a wait in frames: 0 below 3 s, then [3, 6), [6, 12), [12, 24), ... seconds."""
    return int(np.floor(np.log2(wait / frames(3.0)))) + 1 if wait >= frames(3.0) else 0


def answer_bin(mode: str, answer: str, times: Sequence[int], read: str) -> int:
    """Bin of a stored answer: of an event's offset from the first stated time, or of a gap's seconds; a count is its
    own."""
    match decode_answer(mode, answer):
        case FrameAnswer(frame) | FrameViewpoint(frame) | Span(frame):
            return int(np.searchsorted(OFFSET_EDGES_S, (frame - times[0]) / FPS, side="right"))
        case Number(value):
            return int(value) if read == "count" else int(np.searchsorted(GAP_EDGES_S, value, side="right"))
    return 0


def bin_name(mode: str, read: str, number: int) -> str:
    """What a bin of `answer_bin` holds: a range of seconds, or a count.

    >>> bin_name("frame", "start", 2)
    '[6, 10)'
    """
    if read == "count":
        return str(number)
    edges = (0.0, *(GAP_EDGES_S if mode == "number" else OFFSET_EDGES_S))
    above = f"{edges[number + 1]:g}" if number + 1 < len(edges) else "inf"
    return f"[{edges[number]:g}, {above})"


@dataclass(frozen=True, slots=True)
class _Limit:
    """The most that one answer should take of the questions of a template and read.

    strict: it is a rule; otherwise an aim, and where too few could be kept under it, all stay. neighbors: the limit is
    on any two bins next to each other.
    """

    share: float
    strict: bool = False
    neighbors: bool = False


_LIMITS: Final = {
    # A guess of one offset can win a bin of the near ones whole.
    **dict.fromkeys(("start", "span", "start_view"), _Limit(0.25)),
    # A guess of one length, right within a factor of two, wins two bins, or parts of three.
    "seconds_between": _Limit(0.5, neighbors=True),
    "count": _Limit(0.34),
}
"""By read; all others are choices, under `max_answer_share`."""

_WORTH: Final = 0.1
"""Pairs of bins are limited where that keeps at least this share of the candidates."""

_LEVELS: Final = (("stated", "waits"), ("stated",), ("waits",), ())
"""What a reader of the text alone could go by, finest first: a cell with too few different answers to be balanced by
itself is joined with others that look alike in less."""


@dataclass(frozen=True)
class Order:
    """The candidates of one template and read, in an order of which every beginning is balanced like the whole.

    answers: of every row of `rows` the number of its answer, or of the bin that holds it. share: the most that one
    answer may take, None where that is an aim and no rule.
    """

    rows: pa.Table
    order: Ints
    answers: Ints
    share: float | None

    def give(self, wanted: int | None) -> Ints:
        """The first `wanted` rows (None: all), or as many fewer as it takes for no answer to exceed its share."""
        size = len(self.order) if wanted is None else min(wanted, len(self.order))
        if self.share is None:
            return self.order[:size]
        place = _ranks(self.answers[self.order], np.arange(len(self.order)))
        while True:
            stays = np.flatnonzero(place < int(self.share * size + 1e-9))
            if len(stays) >= size:
                return self.order[stays[:size]]
            # Fewer rows leave each answer less room, so there are no more than these.
            size = len(stays)


def ordered(rows: pa.Table, mode: str, read: str, rules: Rules, seed: int) -> Order:
    """The candidates of one template and read, which are answered in one mode, as an order."""
    answers = _answer_codes(rows, mode, read)
    limit = _LIMITS.get(read) or _Limit(rules.max_answer_share, strict=True)
    return Order(rows, _balance(rows, answers, limit, seed), answers, limit.share if limit.strict else None)


def _answer_codes(rows: pa.Table, mode: str, read: str) -> Ints:
    """What is levelled: the answer's text, or the bin of an event's offset or of a gap, or how many are counted."""
    texts = rows["answer"].to_pylist()
    if mode == "multiple_choice":
        return _text_codes(texts)
    times = rows["times"].to_pylist()
    bins = [answer_bin(mode, text, stated, read) for text, stated in zip(texts, times, strict=True)]
    return np.array(bins, np.int64)


def _balance(rows: pa.Table, answers: Ints, limit: _Limit, seed: int) -> Ints:
    """Row numbers that can stay, in an order of which every beginning is balanced nearly as well as the whole."""
    features = {
        "stated": joined(_text_codes([" | ".join(words) for words in rows["stated"].to_pylist()])),
        "waits": joined(_text_codes([_waits(times) for times in rows["times"].to_pylist()])),
    }
    hashes = [hashlib.sha256(f"{seed} {key}".encode()).hexdigest() for key in rows["key"].to_pylist()]
    shuffle = np.argsort(np.argsort(np.array(hashes, dtype="U64"), kind="stable"), kind="stable")
    left = np.ones(rows.num_rows, bool)
    chosen: list[Ints] = []
    places: list[npt.NDArray[np.float64]] = []
    # Lengths are levelled as a whole: of few candidates small cells would keep next to none.
    for level in _LEVELS[-1:] if limit.neighbors else _LEVELS:
        cells = joined(np.zeros(rows.num_rows), *(features[name] for name in level))
        for cell in np.unique(cells[left]):
            members = np.flatnonzero(left & (cells == cell))
            counts = np.bincount(answers[members])
            heights = _level(counts, limit)
            if not heights.any() and not level and not limit.strict:
                heights = counts
            if not heights.any():
                continue
            left[members] = False
            # Within an answer, questions of all waits and all words take turns.
            turn = _ranks(joined(answers[members], features["waits"][members]), shuffle[members])
            turn = _ranks(joined(answers[members], features["stated"][members]), turn * len(shuffle) + shuffle[members])
            rank = _ranks(answers[members], turn * len(shuffle) + shuffle[members])
            most = heights[answers[members]]
            stays = rank < most
            chosen.append(members[stays])
            places.append((rank[stays] + 0.5) / most[stays])
    if not chosen:
        return np.zeros(0, np.int64)
    row, place = np.concatenate(chosen), np.concatenate(places)
    return row[np.lexsort((shuffle[row], place))]


def _level(counts: Ints, limit: _Limit) -> Ints:
    """The most rows to keep of each answer under a limit; all 0 where there are too few answers."""
    if limit.neighbors:
        return _level_pairs(counts, limit.share)
    for height in range(int(counts.max(initial=0)), 0, -1):
        if height <= limit.share * np.minimum(counts, height).sum():
            return np.full_like(counts, height)
    return np.zeros_like(counts)


def _level_pairs(counts: Ints, share: float) -> Ints:
    """The most rows to keep of each bin so that no two bins next to each other hold more than `share`, as even as can
    be; all 0 where that would keep too few."""
    for total in range(int(counts.sum()), int(np.ceil(_WORTH * counts.sum())) - 1, -1):
        most = int(share * total + 1e-9)
        if _under_pairs(counts, most).sum() >= total:
            heights = range(int(counts.max(initial=0)) + 1)
            height = bisect_left(
                heights, total, key=lambda height: _under_pairs(np.minimum(counts, height), most).sum()
            )
            return _under_pairs(np.minimum(counts, height), most)
    return np.zeros_like(counts)


def _under_pairs(counts: Ints, most: int) -> Ints:
    """The most rows of each bin with no more than `most` in two bins next to each other.

    Whatever a bin leaves, only the next one could take, so every bin takes what it can.
    """
    kept = np.zeros_like(counts)
    before = 0
    for number, count in enumerate(counts.tolist()):
        before = kept[number] = min(count, most - before)
    return kept


def _ranks(group: Ints, order: Ints) -> Ints:
    """Place of each row within its group, from 0, by `order`."""
    positions = np.lexsort((order, group))
    sorted_group = group[positions]
    starts = np.r_[True, sorted_group[1:] != sorted_group[:-1]]
    first = np.maximum.accumulate(np.where(starts, np.arange(len(group)), 0))
    ranks = np.empty(len(group), np.int64)
    ranks[positions] = np.arange(len(group)) - first
    return ranks


def _text_codes(texts: Sequence[str]) -> Ints:
    _, codes = np.unique(np.array(texts, dtype=str), return_inverse=True)
    return codes.astype(np.int64)


def _waits(times: Sequence[int]) -> str:
    """Stated times after the first, as waits in bins that double."""
    return " ".join(str(wait_bin(time - times[0])) for time in times[1:])


def joined(*codes: npt.NDArray[Any]) -> Ints:
    """One dense number per distinct combination of numbers."""
    code = np.zeros(len(codes[0]), np.int64)
    for other in codes:
        _, dense = np.unique(other, return_inverse=True)
        _, code = np.unique(code * (int(dense.max(initial=0)) + 1) + dense, return_inverse=True)
    return code.astype(np.int64)
