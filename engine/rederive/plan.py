"""Find the people of a plan: the described person, and the targets of the relations."""

from __future__ import annotations

from dataclasses import dataclass

from jrdb_avr.engine.rederive.labels import Annotations, conjunction, only
from jrdb_avr.engine.rederive.truth import FALSE, Undefined
from jrdb_avr.schema.plan import Condition, Edge, Plan
from jrdb_avr.schema.rules import Rules, frames


@dataclass(frozen=True, slots=True)
class ResolvedPlan:
    """A plan with the people of its nodes.

    Attributes:
        annotations: Annotations of the sequence.
        plan: Plan of the question.
        template: Name of the template.
        people: Tracks by node.
        described: Name of the time of the description and of the relations.
        stated: Frames by name of the stated times.
        rules: Thresholds.
        faults: Rules that the question breaks.
        choices: Answers that the choices state.
    """

    annotations: Annotations
    plan: Plan
    template: str
    people: dict[str, int]
    described: str
    stated: dict[str, int]
    rules: Rules
    faults: list[str]
    choices: tuple[str, ...] = ()

    @property
    def target(self) -> int:
        """Track of the target."""
        return self.people[self.plan.target]

    @property
    def t0(self) -> int:
        """Frame of the description."""
        return self.stated[self.described]

    def frame(self, position: int) -> int:
        """Return a stated frame of the answer.

        Args:
            position: Index among the times of the answer.

        Returns:
            The frame.

        Raises:
            Undefined: If the time is not stated.
        """
        name = self.plan.answer.times[position]
        if name not in self.stated:
            raise Undefined("unknown", f"{name} is not a stated time")
        return self.stated[name]

    def check(self, holds: bool, fault: str) -> None:
        """Note a fault unless a rule holds."""
        if not holds:
            self.faults.append(fault)

    def wait(self, before: int, after: int, seconds: float) -> None:
        """Note a fault if two frames are less than `seconds` apart."""
        self.check(after - before >= frames(seconds), f"frame {after} is less than {seconds:g} s after frame {before}")


def find_people(annotations: Annotations, plan: Plan, template: str, rules: Rules) -> ResolvedPlan:
    """Find all people of a plan.

    Args:
        annotations: Annotations of the sequence.
        plan: Plan of a question.
        template: Name of the template.
        rules: Thresholds.

    Returns:
        The plan with its people, and the rules of descriptions and joins that it breaks.

    Raises:
        Undefined: If a node is not certainly one person.
    """
    stated = {name: time.frame for name, time in sorted(plan.times.items()) if time.frame is not None}
    root = next(node for node in plan.nodes if node.id == plan.root)
    described = next(iter(stated), "")
    times = {condition.at for condition in root.conditions} | {edge.at for edge in plan.edges}
    if not stated or times - {None, described}:
        raise Undefined("unknown", "the description does not hold at a stated time t0")
    if plan.answer.of != plan.target or any(node.conditions for node in plan.nodes if node is not root):
        raise Undefined("unknown", "only the person at the root is described, and only the target is read")
    t0 = stated[described]
    outcome, person = annotations.find(root.conditions, t0)
    if person is None:
        raise Undefined(outcome, f"the description does not certainly fit one single person at frame {t0}")
    resolved = ResolvedPlan(annotations, plan, template, {plan.root: person}, described, stated, rules, [])
    _check_description(resolved, root.conditions)
    failures: list[Undefined] = []
    for node, edges in _edges_by_target(plan).items():
        if any(edge.source not in resolved.people for edge in edges):
            continue
        try:
            resolved.people[node] = _follow(resolved, edges[0]) if len(edges) == 1 else join(resolved, edges)
        except Undefined as reason:
            failures.append(reason)
    if failures:
        # Branches have no order. If one branch certainly leads nowhere, unknown facts of others do not matter.
        raise min(failures, key=lambda reason: ("empty", "ambiguous", "unknown").index(reason.outcome))
    return resolved


def _edges_by_target(plan: Plan) -> dict[str, list[Edge]]:
    """Return the edges by target. Each target comes after the sources of its edges."""
    edges: dict[str, list[Edge]] = {}
    for edge in plan.edges:
        edges.setdefault(edge.target, []).append(edge)
    reached = {plan.root}
    for node, leading in edges.items():
        if any(edge.source not in reached for edge in leading) or node in reached:
            raise Undefined("unknown", f"edges reach {node} before their sources")
        reached.add(node)
    return edges


def _follow(resolved: ResolvedPlan, edge: Edge) -> int:
    """Return the only target of a relation. The target must not be an earlier person of the plan."""
    outcome, person = resolved.annotations.step_to(edge.relation, resolved.people[edge.source], resolved.t0)
    if person is None:
        raise Undefined(outcome, f"{edge.source} does not certainly have one single person {edge.relation!r}")
    if person in resolved.people.values():
        raise Undefined("empty", f"{edge.relation!r} leads from {edge.source} back to a person of the plan")
    return person


def join(resolved: ResolvedPlan, edges: list[Edge]) -> int:
    """Find the common target of several relations.

    Args:
        resolved: Plan with its people. These people cannot be the target.
        edges: Edges to one node.

    Returns:
        Track of the only person who is the target of all edges.

    Raises:
        Undefined: If the edges do not certainly lead to one person.
    """
    annotations, frame = resolved.annotations, resolved.t0
    candidates = [track for track in annotations.uncovered_people(frame) if track not in resolved.people.values()]
    facts = {
        track: [annotations.related(edge.relation, resolved.people[edge.source], track, frame) for edge in edges]
        for track in candidates
    }
    for index, edge in enumerate(edges):
        could = sum(fact[index] != FALSE for fact in facts.values())
        resolved.check(could >= 2, f"{edge.relation!r} of {edge.source} alone leads to {edge.target}")
    into = {edge.target: edge.relation for edge in resolved.plan.edges}
    roads = [into.get(edge.source, "") for edge in edges]
    resolved.check(roads == sorted(set(roads)), "the branches begin alike, or are not in the order of their relations")
    outcome, person = only({track: conjunction(fact) for track, fact in facts.items()})
    if person is None:
        raise Undefined(outcome, f"the branches do not certainly lead to one single person {edges[0].target}")
    return person


def _check_description(resolved: ResolvedPlan, conditions: tuple[Condition, ...]) -> None:
    annotations, t0 = resolved.annotations, resolved.t0
    for frame in sorted(resolved.stated.values()):
        resolved.check(frame in annotations.keyframes, f"frame {frame} is not a keyframe")
    for condition in conditions:
        rest = [kept for kept in conditions if kept is not condition]
        resolved.check(len(annotations.could_match(rest, t0)) >= 2, "the description has a condition too many")
    few = 1 <= len(conditions) <= resolved.rules.max_conditions
    resolved.check(few, f"the description has {len(conditions)} conditions")
    positions = all(condition.attribute in ("sector", "distance") for condition in conditions)
    resolved.check(not positions or not conditions, "a position alone is not a description")
    if any(condition.attribute in ("gender", "age") for condition in conditions):
        visible = annotations.face_visible(resolved.people[resolved.plan.root], t0)
        resolved.check(visible, "gender or age describes a person with a hidden face")
