"""Which proven candidates become questions: near-duplicates, balance, and how many of each family.

Works on Arrow tables of candidates with the columns of `CANDIDATE_COLUMNS`; other columns are carried along. The first
step, `near_duplicates`, looks at one sequence; `select` looks across all. Both depend on the rows alone, never on
their order: whatever is kept is decided by `key` (sha256 hex of sequence, target and plan).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.balance import Order, joined, ordered
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.templates import FAMILIES

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
        code = joined(code, values.indices.to_numpy(zero_copy_only=False))
    return code


# -- all sequences ----------------------------------------------------------------------------------------------


class _Read(msgspec.Struct):
    mode: str
    read: str


class _Asked(msgspec.Struct):
    """What selection has to know of a plan."""

    answer: _Read


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


def _orders(table: pa.Table, rules: Rules, seed: int) -> dict[tuple[str, str], Order]:
    """The balanced candidates by template and by what is read: a template may be asked in several ways."""
    asked = [msgspec.json.decode(plan, type=_Asked).answer for plan in table["plan"].to_pylist()]
    keys = list(zip(table["template"].to_pylist(), (one.read for one in asked), strict=True))
    modes = {key: one.mode for key, one in zip(keys, asked, strict=True)}
    rows: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    found = {}
    for key in sorted(rows):
        found[key] = ordered(table.take(pa.array(rows[key])), modes[key], key[1], rules, seed)
    return found


def _kept(forms: Mapping[str, Sequence[Order]], wanted: int | None) -> dict[str, list[Ints]]:
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
