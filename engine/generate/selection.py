"""Selection: which proven candidates of all sequences become questions, and with which wrong choices.

The result depends on the candidates alone, never on their order. Hashes of the candidates decide among equals.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from jrdb_avr.engine.generate.asked import Candidate, Question, Selected, offer_of, sequence_cap
from jrdb_avr.engine.generate.choice_levels import level_choices
from jrdb_avr.engine.generate.guessers import LabelCounts, guesser_shares
from jrdb_avr.engine.generate.hashes import hash_of
from jrdb_avr.engine.generate.levelling import select_level
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.engine.generate.twins import MAX_TWINS, match_twins
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FAMILIES, forms_of

TRAIN: Final = "train"
"""The profile of training sets: of every template as many as there are, under `training_rules`."""

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
    TRAIN: {},
}
"""Quota of each family, in the order of the paper's table. The profiles without quotas keep all candidates."""

_TOGETHER: Final = (("action_search",), ("span", "start"), ("gap",))
"""Templates without choices. Those that stand together share the quota of their family, and are selected first."""

ORDER: Final = ("fork_join", "three_hop", "two_hop", "consequence", "later_action", "change", "distance", "presence")
"""Templates with choices in the order of selection. As a person is in few questions, scarce templates come first."""

_FIXED: Final = ("distance", "presence")
"""Templates with four fixed answers."""

_CHANGE_QUOTA: Final = 350
"""Maximum number of questions of the template change."""

_LONG_RANGE_PARTS: Final = 3
"""The templates gap and consequence each have at most this part of their family's quota."""

_Row = dict[str, Any]


def quota_of(template: str, quotas: Mapping[str, int], reached: Mapping[str, int]) -> int:
    """Return how many questions a template with choices should give.

    Args:
        template: Name of the template.
        quotas: Quota of each family.
        reached: Number of selected questions of the templates before it.

    Returns:
        What is left of the quota of the family. Change has at most 350, consequence a third of its family's quota, and
        distance half of what change leaves.
    """
    family = FAMILIES[template]
    left = quotas[family] - sum(number for name, number in reached.items() if FAMILIES[name] == family)
    if template == "change":
        return min(_CHANGE_QUOTA, left)
    if template == "consequence":
        return quotas[family] // _LONG_RANGE_PARTS
    return left // 2 if template == "distance" else left


def select(
    pool: Mapping[str, Sequence[Candidate]], counts: LabelCounts, rules: Rules, profile: str, n: int | None = None
) -> tuple[list[Question], list[_Row]]:
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
    quotas = PROFILES[profile]
    if quotas:
        return _select_quotas(pool, counts, Taken(rules), quotas)
    chosen = _deal(pool, Taken(rules), n)
    questions: list[Question] = []
    rows = []
    for template in FAMILIES:
        candidates = chosen.get(template, [])
        if template in ORDER and template not in _FIXED:
            selected = level_choices(candidates, counts)
        else:
            selected = [Question(one, tuple(sorted(one.wrong))) for one in candidates]
        rows.append(_report(template, None, pool.get(template, ()), Selected(selected, None), counts))
        questions += selected
    return questions, rows


def _select_quotas(
    pool: Mapping[str, Sequence[Candidate]], counts: LabelCounts, taken: Taken, quotas: Mapping[str, int]
) -> tuple[list[Question], list[_Row]]:
    questions: list[Question] = []
    rows: dict[str, _Row] = {}
    sequences = len(counts.present)
    for templates in _TOGETHER:
        quota = quotas[FAMILIES[templates[0]]]
        if templates == ("gap",):
            quota //= _LONG_RANGE_PARTS
        candidates = [one for name in templates for one in pool.get(name, ())]
        selected = _level(candidates, quota, taken, sequence_cap(quota, sequences))
        for name in templates:
            own = Selected([one for one in selected.questions if one.candidate.template == name], selected.shortage)
            rows[name] = _report(name, quota // len(templates), pool.get(name, ()), own, counts)
        questions += selected.questions
    for name in ORDER:
        quota = quota_of(name, quotas, {done: row["reached"] for done, row in rows.items()})
        if name == "distance" and not pool.get(name):
            # No sequence has 3D boxes.
            quota = 0
        selected = _select_choices(name, pool.get(name, ()), quota, counts, taken, sequences)
        rows[name] = _report(name, quota, pool.get(name, ()), selected, counts)
        questions += selected.questions
    return questions, [rows[name] for name in FAMILIES]


def _select_choices(
    template: str, candidates: Sequence[Candidate], quota: int, counts: LabelCounts, taken: Taken, sequences: int
) -> Selected:
    """Match the time twins of a template with choices, and select its questions around them."""
    if not candidates or not quota:
        return Selected([], None if quota else "the family is full")
    cap = sequence_cap(quota, sequences, 10 if template == "presence" else 20)
    twins = match_twins(candidates, taken, cap) if template in MAX_TWINS else []
    return select_level(candidates, quota, counts, taken, cap, twins)


def _level(candidates: Iterable[Candidate], quota: int, taken: Taken, cap: int) -> Selected:
    """Select questions without choices, so that templates, and then forms, answers and people, are level."""
    alive = sorted(candidates, key=lambda candidate: hash_of(candidate.key))
    total, chosen, numbers = len(alive), list[Candidate](), Counter[object]()

    def cost(one: Candidate) -> tuple[int, int, int]:
        contexts = sum(weight * numbers[name] for name, weight in one.contexts)
        return numbers[one.template], contexts + numbers[one.moment[:2]], numbers[one.sequence]

    while len(chosen) < quota:
        alive = [one for one in alive if numbers[one.sequence] < cap and taken.admits(one.subject)]
        if not alive:
            break
        best = min(alive, key=cost)
        chosen.append(best)
        taken.add(best.subject)
        numbers.update([best.template, best.moment[:2], best.sequence, *(name for name, _ in best.contexts)])
    shortage = None if len(chosen) == quota else f"caps and near-duplicates leave {len(chosen)} of {total} candidates"
    return Selected([Question(one, ()) for one in chosen], shortage)


def _deal(pool: Mapping[str, Sequence[Candidate]], taken: Taken, n: int | None) -> dict[str, list[Candidate]]:
    """Let the templates choose in turn, in the order of a hash, what caps and near-duplicates allow."""
    queues = {name: iter(sorted(some, key=lambda one: hash_of(one.key))) for name, some in sorted(pool.items())}
    chosen: dict[str, list[Candidate]] = {name: [] for name in queues}
    while queues and (n is None or sum(map(len, chosen.values())) < n):
        for name in list(queues):
            candidate = next((one for one in queues[name] if taken.admits(one.subject)), None)
            if candidate is None:
                del queues[name]
            elif n is None or sum(map(len, chosen.values())) < n:
                chosen[name].append(candidate)
                taken.add(candidate.subject)
    return chosen


def _report(
    template: str, quota: int | None, candidates: Sequence[Candidate], selected: Selected, counts: LabelCounts
) -> _Row:
    questions = selected.questions
    shortage = selected.shortage if candidates else f"nowhere is it certain that {forms_of(template)[0].seeks}"
    offers = [offer_of(question, counts) for question in questions] if template in ORDER else []
    return {
        "family": FAMILIES[template],
        "template": template,
        "quota": quota,
        "proven": len(candidates),
        "reached": len(questions),
        "twins": sum(question.twin is not None for question in questions) // 2,
        "shortage": shortage,
        "guessers": {name: float(share) for name, share in guesser_shares(offers).items()},
    }
