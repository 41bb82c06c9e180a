"""Match time twins: pairs of questions that differ in one asked time and in their answers.

A method that finds the right person and ignores the time cannot answer both.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

from jrdb_avr.engine.generate.asked import Candidate, Twins, moment_hash
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.hashes import hash_of
from jrdb_avr.engine.generate.near_duplicates import Taken, near_frames
from jrdb_avr.schema.rules import Rules

MAX_TWINS: Final = {"change": 50, "presence": 50, "later_action": 9}
"""Maximum number of pairs of each template that has time twins."""


def match_twins(candidates: Iterable[Candidate], taken: Taken, cap: int) -> list[Twins]:
    """Match the candidates of a template to time twins, the moment with the fewest possible twins first.

    Args:
        candidates: The proven candidates of one template, in any order. Twins have equal descriptions, so all
            candidates of a moment count, with whichever description.
        taken: Account of near-duplicates and caps of all templates. It stays as it is.
        cap: Maximum number of questions from one sequence.

    Returns:
        The pairs in the order in which they were matched, at most `MAX_TWINS` of the template.
    """
    partners: dict[int, dict[int, Twins]] = defaultdict(dict)
    for pair in _possible(candidates, taken.rules):
        hashes = [moment_hash(candidate) for candidate in pair]
        for moment, other in itertools.permutations(hashes):
            kept = partners[moment].setdefault(other, pair)
            partners[moment][other] = min(kept, pair, key=_pair_hash)
    return list(_matched(partners, taken.copy(), cap))


def may_be_twins(first: Candidate, second: Candidate, rules: Rules) -> bool:
    """Tell whether two candidates of a template with equal descriptions can be twins.

    Args:
        first: A candidate.
        second: Another one of the same template, person and description.
        rules: The thresholds.

    Returns:
        True if exactly one asked time differs, by more than near-duplicates may, each answer is false in the other
        question, and the same four choices fit both.
    """
    apart = [abs(time - other) for time, other in zip(first.asked, second.asked, strict=True) if time != other]
    if len(apart) != 1 or apart[0] <= near_frames(first.template, rules):
        return False
    if first.truth not in second.wrong or second.truth not in first.wrong:
        return False
    return bool(wrong_sets(first.wrong & second.wrong, 2))


def _possible(candidates: Iterable[Candidate], rules: Rules) -> Iterator[Twins]:
    """Yield all pairs of candidates that can be twins, each in the order of its keys."""
    groups: dict[tuple[str, int, str], list[Candidate]] = defaultdict(list)
    for candidate in candidates:
        groups[candidate.sequence, candidate.track, candidate.described].append(candidate)
    for group in groups.values():
        ordered = sorted(group, key=lambda candidate: candidate.key)
        yield from (pair for pair in itertools.combinations(ordered, 2) if may_be_twins(*pair, rules))


def _matched(partners: Mapping[int, Mapping[int, Twins]], taken: Taken, cap: int) -> Iterator[Twins]:
    """Yield pairs of free moments, the scarcest first, as long as near-duplicates and caps allow them."""
    scarcest = sorted(partners, key=lambda moment: (len(partners[moment]), moment))
    used: set[int] = set()
    per_sequence: dict[str, int] = defaultdict(int)
    count = 0
    for moment in scarcest:
        for other in sorted(partners[moment], key=lambda one: (len(partners[one]), one)):
            pair = partners[moment][other]
            if count == MAX_TWINS[pair[0].template]:
                return
            sequence = pair[0].sequence
            if used & {moment, other} or per_sequence[sequence] + 2 > cap or not _admit(pair, taken):
                continue
            used |= {moment, other}
            per_sequence[sequence] += 2
            count += 1
            yield pair
            break


def _admit(pair: Sequence[Candidate], taken: Taken) -> bool:
    """Add two candidates to the account if it admits both; tell whether it does."""
    first, second = (candidate.subject for candidate in pair)
    if not taken.admits(first):
        return False
    taken.add(first)
    if taken.admits(second):
        taken.add(second)
        return True
    taken.remove(first)
    return False


def _pair_hash(pair: Twins) -> int:
    return hash_of(*(candidate.key for candidate in pair))
