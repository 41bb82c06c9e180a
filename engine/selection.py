"""Which proven candidates become questions: near-duplicates, balance, and how many of each family.

Works on Arrow tables of candidates with the columns of `CANDIDATE_COLUMNS`; other columns are carried along. The first
step, `near_duplicates`, looks at one sequence; `select` looks across all. Both depend on the rows alone, never on
their order: whatever is kept is decided by `key` (sha256 hex of sequence, target and plan).
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Number, Span, decode_answer
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.wording import FAMILIES

CANDIDATE_COLUMNS: Final = (
    "sequence",
    "family",
    "template",
    "target_track",
    "plan",
    "answer",
    "key",
    "read_frames",
    "stated",
    "times",
)
"""`answer` is a choice's text or another answer's stored JSON; `read_frames` are the frames where the answer is read;
`stated` the action words of the question; `times` its stated frames."""

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

OFFSET_EDGES_S: Final = (3.0, 6.0, 10.0, 15.0, 21.0)
GAP_EDGES_S: Final = (5.0, 10.0, 20.0, 40.0)


@dataclass(frozen=True, slots=True)
class _Limit:
    """The most that one answer should take of the questions of a template and read.

    strict: a rule; else an aim: where too few could be kept under it, all stay. neighbors: what is limited is two bins
    next to each other.
    """

    share: float
    strict: bool = False
    neighbors: bool = False


_LIMITS: Final = {
    # A guess of one offset can win a bin of the near ones whole.
    **dict.fromkeys(("start", "span", "start_view"), _Limit(0.25)),
    # A guess of one length, right within a factor of two, wins two bins, or parts of three.
    "seconds_between": _Limit(0.55, neighbors=True),
    "count": _Limit(0.34),
}
"""By read; all others are choices, under `max_answer_share`."""

_WORTH: Final = 0.1
"""Pairs of bins are limited where that keeps at least this share of the candidates."""

_LEVELS: Final = (("stated", "waits"), ("stated",), ("waits",), ())
"""What a reader of the text alone could go by, finest first: a cell with too few different answers to be balanced by
itself is joined with others that look alike in less."""

Ints = npt.NDArray[np.int64]

K = TypeVar("K", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Selection:
    """The kept rows by sequence, template and key, and one report row per template."""

    table: pa.Table
    report: tuple[dict[str, Any], ...]


# -- one sequence -----------------------------------------------------------------------------------------------


def near_duplicates(table: pa.Table, rules: Rules) -> tuple[pa.Table, dict[str, int]]:
    """Keep the first by key of rows that ask nearly the same, and of those at most `max_per_person`.

    Two rows of one template and target are near-duplicates when every frame where the answer is read lies within
    `near_duplicate_s`. Returns the kept rows by (sequence, template, target_track, key) and the rows dropped by rule.
    """
    order = [(name, "ascending") for name in ("sequence", "template", "target_track", "key", "plan")]
    table = table.take(pc.sort_indices(table, sort_keys=order))
    rows = table.num_rows
    read = _padded(table["read_frames"])
    group = _codes(table, ("sequence", "template", "target_track"))
    starts = np.flatnonzero(np.r_[True, group[1:] != group[:-1]][:rows])
    ends = np.append(starts[1:], rows)[: len(starts)]
    limit = frames(rules.near_duplicate_s)
    kept = np.zeros(rows, bool)
    duplicates = 0
    for first, last in zip(starts, ends, strict=True):
        alive = np.arange(first, last)
        for _ in range(rules.max_per_person):
            if not len(alive):
                break
            chosen = alive[0]
            kept[chosen] = True
            near = (np.abs(read[alive] - read[chosen]) <= limit).all(axis=1)
            near[0] = True
            duplicates += int(near.sum()) - 1
            alive = alive[~near]
    dropped = {"near_duplicate": duplicates, "max_per_person": rows - int(kept.sum()) - duplicates}
    return table.filter(pa.array(kept)), {rule: count for rule, count in dropped.items() if count}


def _padded(column: pa.ChunkedArray) -> Ints:
    """Lists as a matrix; what a shorter list lacks is farther from any frame than any rule reaches."""
    lengths = pc.list_value_length(column).to_numpy()
    values = pc.list_flatten(column).to_numpy()
    matrix = np.full((len(lengths), int(lengths.max(initial=0))), -(10**12), np.int64)
    row = np.repeat(np.arange(len(lengths)), lengths)
    matrix[row, np.arange(len(values)) - np.repeat(np.cumsum(lengths) - lengths, lengths)] = values
    return matrix


def _codes(table: pa.Table, names: Sequence[str]) -> Ints:
    """One number per distinct combination of the columns."""
    code = np.zeros(table.num_rows, np.int64)
    for name in names:
        column = pc.dictionary_encode(table[name].combine_chunks())
        values = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
        code = _joined(code, values.indices.to_numpy(zero_copy_only=False))
    return code


def _joined(*codes: npt.NDArray[Any]) -> Ints:
    """One dense number per distinct combination of numbers."""
    code = np.zeros(len(codes[0]), np.int64)
    for other in codes:
        _, dense = np.unique(other, return_inverse=True)
        _, code = np.unique(code * (int(dense.max(initial=0)) + 1) + dense, return_inverse=True)
    return code.astype(np.int64)


# -- all sequences ----------------------------------------------------------------------------------------------


class _Read(msgspec.Struct):
    mode: str
    read: str


class _Asked(msgspec.Struct):
    """What selection has to know of a plan."""

    answer: _Read


@dataclass(frozen=True)
class _Order:
    """The candidates of one template and read, in an order of which every beginning is balanced like the whole.

    answers: of every row of `rows` the number of its answer, or of the bin that holds it. share: the most that one
    answer may take, None where that is an aim and no rule.
    """

    rows: pa.Table
    order: Ints
    answers: Ints
    share: float | None

    def give(self, wanted: int | None) -> Ints:
        """The first so many rows (or all), or as few less as it takes that no answer has more than its share."""
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


def select(table: pa.Table, rules: Rules, profile: str, seed: int) -> Selection:
    """Balance the candidates of all sequences and, under a profile, keep its number per family.

    Within cells of questions that read alike (stated action words, stated waits in doubling bins) answers are
    levelled; event offsets are levelled by their bins, counts by themselves, gaps by pairs of bins. No answer takes
    more than `max_answer_share` of a choice template. What one template of a family cannot give, the others give; what
    one form of a template cannot give, its others give. `profile` is a name of PROFILES.

    The report has a row for every template: family, template, candidates (given), balanced (could be kept), aim (its
    even part of the family's number, None where there is none) and kept.
    """
    orders = _orders(table, rules, seed)
    parts: list[pa.Table] = []
    report: list[dict[str, Any]] = []
    for family in dict.fromkeys(FAMILIES.values()):
        names = [name for name in sorted(FAMILIES) if FAMILIES[name] == family]
        forms = {name: [order for key, order in orders.items() if key[0] == name] for name in names}
        wanted = PROFILES[profile].get(family)
        kept = _kept(forms, wanted)
        aims = _share_out(dict.fromkeys(names, wanted), wanted) if wanted is not None else {}
        for name in names:
            parts += [form.rows.take(pa.array(rows)) for form, rows in zip(forms[name], kept[name], strict=True)]
            report.append(
                {
                    "family": family,
                    "template": name,
                    "candidates": sum(form.rows.num_rows for form in forms[name]),
                    "balanced": sum(len(form.give(None)) for form in forms[name]),
                    "aim": aims.get(name),
                    "kept": sum(map(len, kept[name])),
                }
            )
    result = pa.concat_tables(parts) if parts else table
    order = [(name, "ascending") for name in ("sequence", "template", "key", "plan")]
    return Selection(result.take(pc.sort_indices(result, sort_keys=order)), tuple(report))


def _orders(table: pa.Table, rules: Rules, seed: int) -> dict[tuple[str, str], _Order]:
    """The balanced candidates by template and by what is read: a template may be asked in several ways."""
    asked = [msgspec.json.decode(plan, type=_Asked).answer for plan in table["plan"].to_pylist()]
    keys = list(zip(table["template"].to_pylist(), (one.read for one in asked), strict=True))
    modes = {key: one.mode for key, one in zip(keys, asked, strict=True)}
    rows: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    found = {}
    for key in sorted(rows):
        own, read = table.take(pa.array(rows[key])), key[1]
        answers = _answer_codes(own, modes[key], read)
        limit = _LIMITS.get(read) or _Limit(rules.max_answer_share, strict=True)
        order = _balance(own, answers, limit, seed)
        found[key] = _Order(own, order, answers, limit.share if limit.strict else None)
    return found


def _kept(forms: Mapping[str, Sequence[_Order]], wanted: int | None) -> dict[str, list[Ints]]:
    """Rows of every form of every template of a family, `wanted` in all if they have so many."""
    able = {name: [len(form.give(None)) for form in some] for name, some in forms.items()}
    quotas = _share_out({name: sum(some) for name, some in able.items()}, wanted)
    shares = {name: _share_out(dict(enumerate(able[name])), quotas[name]) for name in forms}
    kept = {name: [form.give(shares[name][place]) for place, form in enumerate(some)] for name, some in forms.items()}
    # Not every number can be had with no answer above its share: what is missing, whoever can give it gives.
    left = sum(quotas.values()) - sum(len(rows) for some in kept.values() for rows in some)
    for name, some in forms.items():
        for place, form in enumerate(some):
            more = form.give(len(kept[name][place]) + left)
            left -= len(more) - len(kept[name][place])
            kept[name][place] = more
    return kept


def _share_out(available: Mapping[K, int], wanted: int | None) -> dict[K, int]:
    """Even shares of `wanted`, in the order of names; what one cannot give is shared among the others."""
    if wanted is None:
        return dict(available)
    quotas = dict.fromkeys(available, 0)
    left = wanted
    while left > 0 and (open_names := [name for name in available if quotas[name] < available[name]]):
        share, extra = divmod(left, len(open_names))
        for position, name in enumerate(open_names):
            step = min(share + (position < extra), available[name] - quotas[name])
            quotas[name] += step
            left -= step
    return quotas


def _balance(rows: pa.Table, answers: Ints, limit: _Limit, seed: int) -> Ints:
    """Row numbers that can stay, in an order of which every beginning is balanced nearly as well as the whole."""
    features = {
        "stated": _joined(_text_codes([" | ".join(words) for words in rows["stated"].to_pylist()])),
        "waits": _joined(_text_codes([_waits(times) for times in rows["times"].to_pylist()])),
    }
    hashes = [hashlib.sha256(f"{seed} {key}".encode()).hexdigest() for key in rows["key"].to_pylist()]
    shuffle = np.argsort(np.argsort(np.array(hashes, dtype="U64"), kind="stable"), kind="stable")
    left = np.ones(rows.num_rows, bool)
    chosen: list[Ints] = []
    places: list[npt.NDArray[np.float64]] = []
    # Lengths are levelled as a whole: of few candidates small cells would keep next to none.
    for level in _LEVELS[-1:] if limit.neighbors else _LEVELS:
        cells = _joined(np.zeros(rows.num_rows), *(features[name] for name in level))
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
            turn = _ranks(_joined(answers[members], features["waits"][members]), shuffle[members])
            turn = _ranks(
                _joined(answers[members], features["stated"][members]), turn * len(shuffle) + shuffle[members]
            )
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


def wait_bin(wait: int) -> int:
    """Bin of a wait in frames: 0 below 3 s, then [3, 6), [6, 12), [12, 24), ... seconds."""
    return int(np.floor(np.log2(wait / frames(3.0)))) + 1 if wait >= frames(3.0) else 0


def _answer_codes(rows: pa.Table, mode: str, read: str) -> Ints:
    """What is levelled: the answer's text, or the bin of an event's offset or of a gap, or how many are counted."""
    texts = rows["answer"].to_pylist()
    if mode == "multiple_choice":
        return _text_codes(texts)
    times = rows["times"].to_pylist()
    bins = [answer_bin(mode, text, stated, read) for text, stated in zip(texts, times, strict=True)]
    return np.array(bins, np.int64)


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
