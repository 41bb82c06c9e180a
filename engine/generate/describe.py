"""Descriptions of people, and the targets of relations.

A description is a set of few conditions. They are certainly true of one person at a keyframe, and together they exclude
each other person in that frame. The shortest set is the best. Among equally short sets the order of kinds in the rules
decides, then a hash. Some descriptions imply more actions than others, and implied actions cannot be choices. So a
second description is the best among the descriptions that imply the fewest actions.
"""

from __future__ import annotations

import hashlib
from functools import reduce
from itertools import combinations
from operator import and_

import msgspec

from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.wording.people import in_order
from jrdb_avr.schema.wording.text import implied_choices


def describe(facts: Facts, sequence: str, track: int, frame: int, rules: Rules) -> dict[tuple[Condition, ...], bool]:
    """Find the best descriptions of a person at a keyframe.

    Args:
        facts: Facts of the sequence.
        sequence: Name of the sequence, which is part of the hash that breaks ties.
        track: Track of the person.
        frame: Keyframe at which the person has a box.
        rules: Order of kinds, and the maximum number of conditions.

    Returns:
        At most two descriptions, each with whether it is the best: the best description, and the best among those that
        imply the fewest actions. Often both are the same.
    """
    order = rules.condition_order
    held = [condition for condition in facts.conditions_of(track, frame) if condition.kind in order]
    held.sort(key=lambda condition: order.index(condition.kind))
    could = [facts.match(condition, frame).could for condition in held]
    # A sector or a distance fits each person who comes by.
    lasting = {number for number, condition in enumerate(held) if condition.kind not in ("sector", "distance")}
    found: list[tuple[int, ...]] = []
    for size in range(1, rules.max_conditions + 1):
        # A set with a smaller one inside has a condition that is not needed.
        sets = [some for some in combinations(range(len(held)), size) if not any(map(set(some).issuperset, found))]
        apart = [some for some in sets if not lasting.isdisjoint(some)]
        found += [some for some in apart if len(reduce(and_, map(could.__getitem__, some))) == 1]
    if not found:
        return {}
    minimal = [tuple(map(held.__getitem__, some)) for some in found]
    prefix = f"{sequence}\n{track}\n{frame}\n"
    general = _best_of([some for some in minimal if len(some) == len(minimal[0])], prefix, order)
    least = min(len(implied_choices(some)) for some in minimal)
    quiet = [some for some in minimal if len(implied_choices(some)) == least]
    shortest = [some for some in quiet if len(some) == len(quiet[0])]
    return {some: some == general for some in (general, _best_of(shortest, prefix, order))}


def _best_of(sets: list[tuple[Condition, ...]], prefix: str, order: tuple[str, ...]) -> tuple[Condition, ...]:
    """Return the best of equally long sets: by the order of their kinds, then by hash."""
    ranks = [tuple(order.index(condition.kind) for condition in some) for some in sets]
    tied = [some for some, rank in zip(sets, ranks, strict=True) if rank == min(ranks)]
    texts = [msgspec.json.encode(in_order(some), order="sorted").decode()[1:-1] for some in tied]
    hashes = [hashlib.sha256(f"{prefix}{text}".encode()).digest() for text in texts]
    return tied[hashes.index(min(hashes))]


def find_leads(facts: Facts, track: int, frame: int) -> dict[str, int]:
    """Find the person at the end of each relation.

    Args:
        facts: Facts of the sequence.
        track: Track of the source of the relations.
        frame: Keyframe at which the person has a box.

    Returns:
        The track of the only person who certainly has the relation while no other person may have it, by relation.
    """
    fits = {relation: facts.follow(relation, track, frame) for relation in facts.relations_of(track, frame)}
    return {relation: min(certain) for relation, (could, certain) in fits.items() if len(could) == len(certain) == 1}
