"""What identifies a question, and what its text states."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import msgspec

from ..plan import Condition, Plan, canonical
from .phrases import POSES_OF_INTERACTIONS, POSES_OF_VERBS


def question_key(sequence: str, target: int, plan: Plan) -> str:
    """64 hex digits that decide among paraphrases and near-duplicates: sha256 of sequence, target and plan."""
    return hashlib.sha256(f"{sequence}\n{target}\n{canonical(plan)}".encode()).hexdigest()


def question_id(
    sequence: str, family: str, template: str, question: str, choices: Sequence[str], answer_mode: str
) -> str:
    """16 hex digits of the public columns of a question, and of nothing else."""
    public = msgspec.json.encode([sequence, family, template, question, list(choices), answer_mode])
    return hashlib.sha256(public).hexdigest()[:16]


def actions_of(condition: Condition) -> tuple[str, ...]:
    """The actions that a condition's words name: its own, or the poses that go with an interaction or a verb.

    >>> actions_of(Condition(interaction="sitting together", at="t0"))
    ('sitting',)
    """
    if condition.action is not None:
        return (condition.action,)
    if condition.interaction is not None:
        return poses_of(condition.interaction)
    return POSES_OF_VERBS.get(condition.verb or "", ())


def poses_of(relation: str) -> tuple[str, ...]:
    """The pose that a relation gives away, if any: people who are "walking together" walk."""
    return (POSES_OF_INTERACTIONS[relation],) if relation in POSES_OF_INTERACTIONS else ()


def stated_actions(plan: Plan) -> tuple[str, ...]:
    """The action words of the question: of descriptions, events and relations, sorted, each once."""
    words = {word for node in plan.nodes for condition in node.conditions for word in actions_of(condition)}
    words |= {word for edge in plan.edges for word in poses_of(edge.relation)}
    words |= {time.action for time in plan.times.values() if time.action is not None}
    return tuple(sorted(words | set(poses_of(plan.answer.relation or ""))))


def stated_frames(plan: Plan) -> tuple[int, ...]:
    """The frames stated in the question, by the names of their times."""
    return tuple(time.frame for _, time in sorted(plan.times.items()) if time.frame is not None)
