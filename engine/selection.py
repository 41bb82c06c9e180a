"""Which proven candidates become questions: near-duplicates, balance, and how many of each family.

Works on Arrow tables of candidates with the columns of `CANDIDATE_COLUMNS`; other columns are carried along. The first
step, `near_duplicates`, looks at one sequence; `select` looks across all. Both depend on the rows alone, never on
their order: whatever is kept is decided by `key` (sha256 hex of sequence, target and plan).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Number, Span, decode_answer
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS, Rules, frames

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
"""Questions per family; a family that is not named keeps all that balance leaves."""

OFFSET_EDGES_S: Final = (3.0, 6.0, 10.0, 15.0, 21.0)
GAP_EDGES_S: Final = (5.0, 10.0, 20.0, 40.0)

_TIME_SHARES: Final = {"frame": 0.25, "span": 0.25, "frame_viewpoint": 0.25, "number": 0.29}
"""The most that one bin of offsets or gaps should take: a guess of one offset can win a bin of the near ones whole, and
a guess of one length, right within a factor of two, wins two bins."""

_LEVELS: Final = (("stated", "waits"), ("stated",), ("waits",), ())
"""What a reader of the text alone could go by, finest first: a cell with too few different answers to be balanced by
itself is joined with others that look alike in less."""

Ints = npt.NDArray[np.int64]


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


def select(table: pa.Table, rules: Rules, profile: str, seed: int) -> Selection:
    """Balance the candidates of all sequences and, under a profile, keep its number per family.

    Within cells of questions that read alike (stated action words, stated waits in doubling bins) answers are
    levelled; event offsets and gaps are levelled by their bins. No answer takes more than `max_answer_share` of a
    choice template. What one template of a family cannot give, the others give. `profile` is a name of PROFILES.
    """
    parts: list[pa.Table] = []
    report: list[dict[str, Any]] = []
    wanted = PROFILES[profile]
    for family in sorted(set(table["family"].to_pylist())):
        of_family = table.filter(pc.equal(table["family"], family))
        names = sorted(set(of_family["template"].to_pylist()))
        templates = {name: of_family.filter(pc.equal(of_family["template"], name)) for name in names}
        balanced = {name: _balance(rows, rules, seed) for name, rows in templates.items()}
        quotas = _share_out({name: len(order) for name, order in balanced.items()}, wanted.get(family))
        for name, rows in templates.items():
            keep = balanced[name][: quotas[name]]
            if _mode(rows) == "multiple_choice":
                keep = _trim(keep, _answer_codes(rows), rules.max_answer_share)
            parts.append(rows.take(pa.array(keep)))
            report.append(
                {
                    "family": family,
                    "template": name,
                    "candidates": rows.num_rows,
                    "balanced": len(balanced[name]),
                    "kept": len(keep),
                }
            )
        kept = sum(row["kept"] for row in report if row["family"] == family)
        for row in report:
            if row["family"] == family:
                row["family_wanted"] = wanted.get(family)
                row["family_short"] = max(0, wanted.get(family, 0) - kept)
    for family, number in sorted(wanted.items()):
        if family not in {row["family"] for row in report}:
            none = {"candidates": 0, "balanced": 0, "kept": 0}
            report.append({"family": family, "template": "-", **none, "family_wanted": number, "family_short": number})
    result = pa.concat_tables(parts) if parts else table
    order = [(name, "ascending") for name in ("sequence", "template", "key", "plan")]
    return Selection(result.take(pc.sort_indices(result, sort_keys=order)), tuple(report))


def _share_out(available: Mapping[str, int], wanted: int | None) -> dict[str, int]:
    """Even shares of `wanted`; what one cannot give is shared among the others."""
    if wanted is None:
        return dict(available)
    quotas = dict.fromkeys(available, 0)
    left = wanted
    while left > 0 and (open_names := [name for name in sorted(available) if quotas[name] < available[name]]):
        share, extra = divmod(left, len(open_names))
        for position, name in enumerate(open_names):
            step = min(share + (position < extra), available[name] - quotas[name])
            quotas[name] += step
            left -= step
    return quotas


def _balance(rows: pa.Table, rules: Rules, seed: int) -> Ints:
    """Row numbers that can stay, in an order of which every beginning is balanced nearly as well as the whole."""
    answers, mode = _answer_codes(rows), _mode(rows)
    share = _TIME_SHARES.get(mode, rules.max_answer_share)
    features = {
        "stated": _joined(_text_codes([" | ".join(words) for words in rows["stated"].to_pylist()])),
        "waits": _joined(_text_codes([_waits(times) for times in rows["times"].to_pylist()])),
    }
    hashes = [hashlib.sha256(f"{seed} {key}".encode()).hexdigest() for key in rows["key"].to_pylist()]
    shuffle = np.argsort(np.argsort(np.array(hashes, dtype="U64"), kind="stable"), kind="stable")
    left = np.ones(rows.num_rows, bool)
    chosen: list[Ints] = []
    places: list[npt.NDArray[np.float64]] = []
    for level in _LEVELS:
        cells = _joined(np.zeros(rows.num_rows), *(features[name] for name in level))
        for cell in np.unique(cells[left]):
            members = np.flatnonzero(left & (cells == cell))
            height = _level(np.bincount(answers[members]), share)
            if not height and not level and mode in _TIME_SHARES:
                # For times the share is an aim, not a rule: with too few bins to level, all stay.
                height = len(members)
            if not height:
                continue
            left[members] = False
            # Within an answer, questions of all waits and all words take turns.
            turn = _ranks(_joined(answers[members], features["waits"][members]), shuffle[members])
            turn = _ranks(
                _joined(answers[members], features["stated"][members]), turn * len(shuffle) + shuffle[members]
            )
            rank = _ranks(answers[members], turn * len(shuffle) + shuffle[members])
            stays = rank < height
            chosen.append(members[stays])
            places.append((rank[stays] + 0.5) / height)
    if not chosen:
        return np.zeros(0, np.int64)
    row, place = np.concatenate(chosen), np.concatenate(places)
    return row[np.lexsort((shuffle[row], place))]


def _level(counts: Ints, share: float) -> int:
    """The most rows per answer so that no answer takes more than `share`; 0 where there are too few answers."""
    counts = counts[counts > 0]
    for height in range(int(counts.max(initial=0)), 0, -1):
        if height <= share * np.minimum(counts, height).sum():
            return height
    return 0


def _trim(keep: Ints, answers: Ints, share: float) -> Ints:
    """Drop the last rows of answers that take more than `share`, until none does."""
    while len(keep):
        counts = np.bincount(answers[keep])
        top = int(counts.argmax())
        # Without some of its own rows the whole shrinks too: the top may have share * rest / (1 - share).
        if counts[top] <= share * len(keep):
            break
        limit = int(share * (len(keep) - counts[top]) / (1 - share) + 1e-9)
        own = np.flatnonzero(answers[keep] == top)
        keep = np.delete(keep, own[limit:])
    return keep


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


def _mode(rows: pa.Table) -> str:
    return msgspec.json.decode(rows["plan"][0].as_py(), type=Plan).answer.mode


def _answer_codes(rows: pa.Table) -> Ints:
    """What is levelled: the answer's text, or the bin of an event's offset, or the bin of a gap."""
    mode = _mode(rows)
    texts = rows["answer"].to_pylist()
    if mode == "multiple_choice":
        return _text_codes(texts)
    return np.array(
        [answer_bin(mode, text, times) for text, times in zip(texts, rows["times"].to_pylist(), strict=True)], np.int64
    )


def answer_bin(mode: str, answer: str, times: Sequence[int]) -> int:
    """Bin of a stored answer: an event's offset from the first stated time, or a gap's seconds."""
    match decode_answer(mode, answer):
        case FrameAnswer(frame) | FrameViewpoint(frame) | Span(frame):
            return int(np.searchsorted(OFFSET_EDGES_S, (frame - times[0]) / FPS, side="right"))
        case Number(value):
            return int(np.searchsorted(GAP_EDGES_S, value, side="right"))
    return 0
