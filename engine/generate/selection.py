"""Selection: which proven candidates of all sequences become questions, and with which wrong choices.

The result depends on the candidates alone, never on their order. Hashes of the candidates decide among equals.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Container, Iterable, Mapping, Sequence
from itertools import chain
from typing import Final

from jrdb_avr.engine.generate.asked import Candidate, Question, Selected, offer_of, sequence_cap
from jrdb_avr.engine.generate.guessers import LabelCounts, guesser_shares
from jrdb_avr.engine.generate.layer import TableRow
from jrdb_avr.engine.generate.levelling import level_choices, select_level
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.engine.report.hashes import hash_of
from jrdb_avr.engine.report.paper import QUOTAS
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FAMILIES, forms_of

TRAIN: Final = "train"
"""The profile of training sets: of every template as many as there are, under `training_rules`."""

PROFILES: Final[dict[str, dict[str, int]]] = {"all": {}, "paper": QUOTAS, "lite": QUOTAS, TRAIN: {}}
"""Quota of each family, in the order of the paper's table. The profiles without quotas keep all candidates.

The profile lite keeps a part of the selected questions (`engine/generate/lite.py`)."""

STAGES: Final = (
    *(("span", "start"), ("action_search",), ("gap",), ("fork_join",), ("three_hop",), ("two_hop",)),
    *(("consequence",), ("later_action",), ("change",), ("distance",), ("presence",)),
)
"""Templates in the order of selection. Templates in one tuple share the quota of their family.

As a person is in few questions, templates with few candidates come first. Other templates follow them.
"""

_POOL_CAPS: Final = 2
"""Number of candidates in one sequence for each question that may be selected there."""

_CHANGE_QUOTA: Final = 350
"""Maximum number of questions of the template change."""

_LONG_RANGE_PARTS: Final = 3
"""The templates gap and consequence each have at most this part of their family's quota."""


def quota_of(template: str, quotas: Mapping[str, int], reached: Mapping[str, int]) -> int:
    """Return how many questions a template should give.

    Args:
        template: Name of the template.
        quotas: Quota of each family.
        reached: Number of selected questions of the templates before it.

    Returns:
        The rest of the quota of the family. Change has at most 350, gap and consequence a third of their family's
        quota, and distance half of what change leaves.
    """
    family = FAMILIES[template]
    left = quotas[family] - sum(number for name, number in reached.items() if FAMILIES[name] == family)
    if template == "change":
        return min(_CHANGE_QUOTA, left)
    if template in ("gap", "consequence"):
        return quotas[family] // _LONG_RANGE_PARTS
    return left // 2 if template == "distance" else left


def pool_limits(profile: str, sequences: int) -> tuple[tuple[str, int], ...]:
    """Return how many candidates of each template are enough in one sequence.

    Args:
        profile: Name of `PROFILES`.
        sequences: Number of sequences.

    Returns:
        The numbers by template, none for a profile without quotas.
    """
    quotas = PROFILES[profile]
    caps = {name: sequence_cap(name, quota_of(name, quotas, {}), sequences) for name in FAMILIES if quotas}
    return tuple((name, _POOL_CAPS * cap) for name, cap in caps.items())


def select(
    pool: Mapping[str, Sequence[Candidate]], counts: LabelCounts, rules: Rules, profile: str, n: int | None = None
) -> tuple[list[Question], list[TableRow]]:
    """Select the questions of all templates.

    Args:
        pool: The proven candidates of each template, in any order.
        counts: How common actions are in all sequences.
        rules: Rules of near-duplicates and caps.
        profile: Name of `PROFILES`.
        n: Maximum number of questions of a profile without quotas, or None for all.

    Returns:
        The selected questions. Also a row per template: family, template, quota, proven, reached, twins (pairs),
        shortage and guessers (the share of right answers of each guesser that counts).
    """
    quotas, taken = PROFILES[profile], Taken(rules)
    dealt = [one for some in pool.values() for one in some] if quotas else _deal(pool, taken, n)
    questions: list[Question] = []
    rows: dict[str, TableRow] = {}
    for names in (*STAGES, *((name,) for name in FAMILIES if name not in chain(*STAGES))):
        candidates = [one for one in dealt if one.template in names]
        quota = shortage = None
        if quotas:
            quota = quota_of(names[0], quotas, {name: row["reached"] for name, row in rows.items()})
            # No sequence has 3D boxes if there is no candidate of the template distance.
            quota = 0 if names == ("distance",) and not candidates else quota
            events = {(one.person, one.event) for one in pool.get("action_search", ())} if "start" in names else set()
            selected, shortage = list[Question](), None if quota else "the family is full"
            if candidates and quota:
                cap = sequence_cap(names[0], quota, len(counts.present))
                if forms_of(names[0])[0].answer is None:
                    selected, shortage = select_level(candidates, quota, counts, taken, cap)
                else:
                    selected, shortage = _level(candidates, quota, taken, cap, events)
        elif forms_of(names[0])[0].asks_action:
            selected = level_choices(candidates, counts, rules)
        else:
            selected = [Question(one, tuple(sorted(one.wrong))) for one in candidates]
        for name in names:
            form, own = forms_of(name)[0], [one for one in selected if one.candidate.template == name]
            shares = guesser_shares([offer_of(one, counts) for one in own] if form.answer is None else [])
            rows[name] = {
                "family": form.family,
                "template": name,
                "quota": None if quota is None else quota // len(names),
                "proven": len(pool.get(name, ())),
                "reached": len(own),
                "twins": sum(one.twin is not None for one in own) // 2,
                "shortage": shortage if pool.get(name) else f"nowhere is it certain that {form.seeks}",
                "guessers": {guesser: float(share) for guesser, share in shares.items()},
            }
        questions += selected
    return questions, [rows[name] for name in FAMILIES]


def _level(candidates: Iterable[Candidate], quota: int, taken: Taken, cap: int, events: Container[object]) -> Selected:
    """Select questions without choices, so that templates, and then forms, answers and people, are level.

    Events that a later template can ask about come last.
    """
    alive = sorted(candidates, key=lambda candidate: hash_of(candidate.key))
    total, chosen, numbers = len(alive), list[Candidate](), Counter[object]()

    def cost(candidate: Candidate) -> tuple[int, bool, int, int]:
        level = sum(weight * numbers[name] for name, weight in candidate.contexts) + numbers[candidate.person]
        asked_later = (candidate.person, candidate.event) in events
        return numbers[candidate.template], asked_later, level, numbers[candidate.sequence]

    while len(chosen) < quota and (
        alive := [candidate for candidate in alive if numbers[candidate.sequence] < cap and taken.admits(candidate)]
    ):
        best = min(alive, key=cost)
        chosen.append(best)
        taken.add(best)
        numbers.update([best.template, best.person, best.sequence, *(name for name, _ in best.contexts)])
    shortage = None if len(chosen) == quota else f"caps and near-duplicates leave {len(chosen)} of {total} candidates"
    return [Question(candidate, ()) for candidate in chosen], shortage


def _deal(pool: Mapping[str, Sequence[Candidate]], taken: Taken, n: int | None) -> list[Candidate]:
    """Let the templates choose in turn, in the order of a hash, what caps and near-duplicates allow."""
    queues = deque(iter(sorted(some, key=lambda one: hash_of(one.key))) for _, some in sorted(pool.items()))
    chosen: list[Candidate] = []
    while queues and (n is None or len(chosen) < n):
        queue = queues.popleft()
        candidate = next((one for one in queue if taken.admits(one)), None)
        if candidate is not None:
            chosen.append(candidate)
            taken.add(candidate)
            queues.append(queue)
    return chosen
