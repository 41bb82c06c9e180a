"""Which proven candidates become questions: near-duplicates, balance, and how many of each family.

The first step, `near_duplicates`, looks at one template in one sequence; `select` looks across all. Both depend on the
rows alone, never on their order: `key` decides which rows stay (sha256 hex of sequence, target and plan).

Balance: no answer so common that it could be guessed, as far as the candidates allow. The candidates of one template
and one kind of read are levelled by their answers (or the bins that hold them), within cells of questions that read
alike, and put into an order of which every beginning is balanced like the whole.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.bins import answer_bin, wait_bin
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import FAMILIES

POOL: Final = pa.schema(
    [
        *dict.fromkeys((*QUESTIONS["questions"], *QUESTIONS["answers"])),
        ("key", pa.string()),
        ("answer_text", pa.string()),
        ("stated", pa.list_(pa.string())),
        ("times", pa.list_(pa.int32())),
    ]
)
"""Columns of the records that selection chooses from: those of the tables `questions` and `answers`, and what it goes
by. `answer_text` is a choice's text or another answer's stored JSON; `stated` the action words of the question; `times`
its stated frames."""

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

K = TypeVar("K", bound=Hashable)

KEPT: Final = ""
"""Verdict of `near_duplicates` on a row that stays."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected rows by sequence, template and key, and one report row per template."""

    table: pa.Table
    report: tuple[dict[str, Any], ...]


def near_duplicates(table: pa.Table, rules: Rules) -> npt.NDArray[np.str_]:
    """Per row of one template in one sequence: KEPT, or the rule that drops it.

    near_duplicate: every frame where the answer is read lies within `near_duplicate_s` of those of a row of the
    same target that stays, with a smaller key; max_per_person: as many as that of the target stay already.
    """
    order = pc.sort_indices(table, sort_keys=[("target_track", "ascending"), ("key", "ascending")]).to_numpy()
    track = table["target_track"].to_numpy()[order]
    read = pc.list_flatten(table["read_frames"]).to_numpy().reshape(len(table), -1) if len(table) else np.zeros((0, 1))
    verdicts = np.full(len(table), "max_per_person")
    for rows in np.split(order, np.flatnonzero(np.diff(track)) + 1):
        alive = rows
        for _ in range(rules.max_per_person):
            if not len(alive):
                break
            near = np.all(np.abs(read[alive] - read[alive[0]]) <= frames(rules.near_duplicate_s), axis=1)
            verdicts[alive[near]] = "near_duplicate"
            verdicts[alive[0]] = KEPT
            alive = alive[~near]
    return verdicts


# -- all sequences ----------------------------------------------------------------------------------------------


def select(table: pa.Table, rules: Rules, profile: str, seed: int) -> Selection:
    """Balance the candidates of all sequences and, under a profile, keep its number per family.

    Within cells of questions that read alike (stated action words, stated waits in doubling bins) answers are
    levelled; event offsets are levelled by their bins, counts by themselves, gaps by pairs of bins. No answer takes
    more than `max_answer_share` of a choice template. What one template of a family cannot give, the others give; what
    one form of a template cannot give, its others give. `profile` is a name of PROFILES.

    The report has a row for every template: family, template, candidates (in all), balanced (could stay), aim (its
    even part of the family's number, None where there is none) and kept (selected).
    """
    orders = _orders(table, rules, seed)
    parts: list[pa.Table] = []
    report: list[dict[str, Any]] = []
    for family in dict.fromkeys(FAMILIES.values()):
        names = [name for name in sorted(FAMILIES) if FAMILIES[name] == family]
        forms = {name: orders.get(name, []) for name in names}
        wanted = PROFILES[profile].get(family)
        chosen = _chosen(forms, wanted)
        aims = _share_out(dict.fromkeys(names, wanted), wanted) if wanted is not None else {}
        for name in names:
            parts += [form.rows.take(pa.array(rows)) for form, rows in zip(forms[name], chosen[name], strict=True)]
            report.append(
                {
                    "family": family,
                    "template": name,
                    "candidates": sum(form.rows.num_rows for form in forms[name]),
                    "balanced": sum(len(form.give(None)) for form in forms[name]),
                    "aim": aims.get(name),
                    "kept": sum(map(len, chosen[name])),
                }
            )
    result = pa.concat_tables(parts) if parts else table
    order = [(name, "ascending") for name in ("sequence", "template", "key", "plan")]
    return Selection(result.sort_by(order), tuple(report))


def _orders(table: pa.Table, rules: Rules, seed: int) -> dict[str, list[_Order]]:
    """The balanced candidates by template, one order for each thing that is read: a template may have several forms."""
    rows: dict[tuple[str, str, str], list[int]] = defaultdict(list)
    for row, (name, plan) in enumerate(zip(table["template"].to_pylist(), table["plan"].to_pylist(), strict=True)):
        answer = msgspec.json.decode(plan)["answer"]
        rows[name, answer["read"], answer["mode"]].append(row)
    orders: dict[str, list[_Order]] = defaultdict(list)
    for (name, read, mode), places in sorted(rows.items()):
        orders[name].append(_ordered(table.take(pa.array(places)), mode, read, rules, seed))
    return orders


def _chosen(forms: Mapping[str, Sequence[_Order]], wanted: int | None) -> dict[str, list[Ints]]:
    """Rows of every form of every template of a family, `wanted` in all if they have so many."""
    able = {name: [len(form.give(None)) for form in some] for name, some in forms.items()}
    quotas = _share_out({name: sum(some) for name, some in able.items()}, wanted)
    shares = {name: _share_out(dict(enumerate(able[name])), quotas[name]) for name in forms}
    picked = {name: [form.give(shares[name][place]) for place, form in enumerate(some)] for name, some in forms.items()}
    # Not every number is possible with no answer above its share: other templates fill what is missing.
    left = sum(quotas.values()) - sum(len(rows) for some in picked.values() for rows in some)
    for name, some in forms.items():
        for place, form in enumerate(some):
            more = form.give(len(picked[name][place]) + left)
            left -= len(more) - len(picked[name][place])
            picked[name][place] = more
    return picked


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


# -- balance ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Limit:
    """The most that one answer should take of the questions of a template and read.

    strict: it is a rule; otherwise an aim, and where too few could stay under it, all do. neighbors: the limit is
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


def _ordered(rows: pa.Table, mode: str, read: str, rules: Rules, seed: int) -> _Order:
    """The candidates of one template and read, which are answered in one mode, as an order.

    Selection balances the answer's text, or the bin of an event's offset or of a gap, or how many are counted.
    """
    texts, times = rows["answer_text"].to_pylist(), rows["times"].to_pylist()
    if mode == "multiple_choice":
        answers = _dense(texts)
    else:
        answers = np.array([answer_bin(mode, *pair, read) for pair in zip(texts, times, strict=True)], np.int64)
    limit = _LIMITS.get(read) or _Limit(rules.max_answer_share, strict=True)
    return _Order(rows, _balance(rows, answers, limit, seed), answers, limit.share if limit.strict else None)


def _balance(rows: pa.Table, answers: Ints, limit: _Limit, seed: int) -> Ints:
    """Row numbers that can stay, in an order of which every beginning is balanced nearly as well as the whole."""
    stated = _dense([" | ".join(words) for words in rows["stated"].to_pylist()])
    # Stated times after the first, as waits in bins that double.
    waits = _dense([" ".join(str(wait_bin(t - first)) for t in more) for first, *more in rows["times"].to_pylist()])
    hashes = [hashlib.sha256(f"{seed} {key}".encode()).hexdigest() for key in rows["key"].to_pylist()]
    shuffle = _dense(hashes)
    left = np.ones(rows.num_rows, bool)
    chosen: list[Ints] = []
    places: list[npt.NDArray[np.float64]] = []
    # Features that the text alone reveals, finest first: a cell with too few different answers to be balanced by
    # itself is joined with others that look alike in less. Lengths are levelled as a whole: of few candidates small
    # cells would keep next to none.
    whole = np.zeros(rows.num_rows, np.int64)
    for cells in [whole] if limit.neighbors else [_dense(list(zip(stated, waits, strict=True))), stated, waits, whole]:
        for cell in np.unique(cells[left]):
            members = np.flatnonzero(left & (cells == cell))
            counts = np.bincount(answers[members])
            heights = _level(counts, limit)
            if not heights.any() and cells is whole and not limit.strict:
                heights = counts
            if not heights.any():
                continue
            left[members] = False
            # Within an answer, questions of all waits and all words take turns.
            answer, mix = answers[members], shuffle[members]
            turn = np.zeros(len(members), np.int64)
            for feature in (waits[members], stated[members], None):
                alike = answer if feature is None else answer * len(left) + feature
                turn = _ranks(alike, turn * len(left) + mix)
            most = heights[answer]
            stays = turn < most
            chosen.append(members[stays])
            places.append((turn[stays] + 0.5) / most[stays])
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
    most_of = np.zeros_like(counts)
    before = 0
    for number, count in enumerate(counts.tolist()):
        before = most_of[number] = min(count, most - before)
    return most_of


def _ranks(group: Ints, order: Ints) -> Ints:
    """Place of each row within its group, from 0, by `order`."""
    positions = np.lexsort((order, group))
    sorted_group = group[positions]
    starts = np.r_[True, sorted_group[1:] != sorted_group[:-1]]
    first = np.maximum.accumulate(np.where(starts, np.arange(len(group)), 0))
    ranks = np.empty(len(group), np.int64)
    ranks[positions] = np.arange(len(group)) - first
    return ranks


def _dense(values: Sequence[Hashable]) -> Ints:
    """Every value as its place among the distinct ones."""
    place = {value: number for number, value in enumerate(sorted(set(values)))}  # type: ignore[type-var]
    return np.array([place[value] for value in values], np.int64)
