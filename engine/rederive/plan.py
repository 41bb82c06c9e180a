"""Find the people of a plan: the person of the description, and those to whom relations lead."""

from __future__ import annotations

from dataclasses import dataclass

from jrdb_avr.engine.rederive.labels import Annotations, conjunction, only
from jrdb_avr.engine.rederive.truth import FALSE, Undefined
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Condition, Edge, Plan
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.wording.text import actions_of


@dataclass(frozen=True, slots=True)
class ResolvedPlan:
    """A plan and the people of its nodes. `faults` collects the rules of the template that do not hold.

    described: the name of the time at which the description holds, and the relations; stated: frames by name.
    """

    annotations: Annotations
    plan: Plan
    template: str
    people: dict[str, int]
    described: str
    stated: dict[str, int]
    rules: Rules
    faults: list[str]

    @property
    def target(self) -> int:
        return self.people[self.plan.target]

    @property
    def t0(self) -> int:
        """The frame at which the description holds."""
        return self.stated[self.described]

    def frame(self, position: int) -> int:
        """The stated frame at which the answer is read."""
        name = self.plan.answer.times[position]
        if name not in self.stated:
            raise Undefined("unknown", f"{name} is no stated time")
        return self.stated[name]

    def check(self, holds: bool, fault: str) -> None:
        """Note a rule that does not hold."""
        if not holds:
            self.faults.append(fault)

    def wait(self, before: int, after: int, seconds: float) -> None:
        """Note a fault where two times lie too near."""
        self.check(after - before >= frames(seconds), f"frame {after} is less than {seconds:g} s after frame {before}")


def find_people(annotations: Annotations, plan: Plan, template: str, rules: Rules) -> ResolvedPlan:
    """Find everybody of a plan. Raises Undefined where one of them is not a single person for certain."""
    stated = {name: time.frame for name, time in sorted(plan.times.items()) if time.frame is not None}
    root = next(node for node in plan.nodes if node.id == plan.root)
    described = next(iter(stated), "")
    held = {condition.at for condition in root.conditions} | {edge.at for edge in plan.edges}
    if not stated or held - {None, described}:
        raise Undefined("unknown", "the description does not hold at a stated time t0")
    if plan.answer.of != plan.target or any(node.conditions for node in plan.nodes if node is not root):
        raise Undefined("unknown", "only the person at the root is described, and only the target is read")
    t0 = stated[described]
    result, person = annotations.find(root.conditions, t0)
    if person is None:
        raise Undefined(result, f"the description fits no one person for certain at frame {t0}")
    found = ResolvedPlan(annotations, plan, template, {plan.root: person}, described, stated, rules, [])
    _check_description(found, root.conditions)
    nobody: list[Undefined] = []
    for node, edges in _by_target(plan).items():
        if any(edge.source not in found.people for edge in edges):
            continue
        try:
            found.people[node] = _follow(found, edges) if len(edges) == 1 else join(found, edges)
        except Undefined as reason:
            nobody.append(reason)
    if nobody:
        # Branches have no order: where one certainly leads to nobody, what is unknown of another does not matter.
        raise min(nobody, key=lambda reason: ("empty", "ambiguous", "unknown").index(reason.outcome))
    return found


def _by_target(plan: Plan) -> dict[str, list[Edge]]:
    """Edges by the person they lead to, who comes after those they lead from."""
    edges: dict[str, list[Edge]] = {}
    for edge in plan.edges:
        edges.setdefault(edge.target, []).append(edge)
    known = {plan.root}
    for node, leading in edges.items():
        if any(edge.source not in known for edge in leading) or node in known:
            raise Undefined("unknown", f"edges reach {node} before those they come from")
        known.add(node)
    return edges


def _follow(found: ResolvedPlan, edges: list[Edge]) -> int:
    """The one other person, people of the plan included, to whom a relation leads; going back leads nowhere."""
    edge = edges[0]
    result, person = found.annotations.step_to(edge.relation, found.people[edge.source], found.t0)
    if person is None:
        raise Undefined(result, f"{edge.source} has no one person for certain {edge.relation!r}")
    if person in found.people.values():
        raise Undefined("empty", f"{edge.relation!r} leads from {edge.source} back to somebody of the plan")
    return person


def join(found: ResolvedPlan, edges: list[Edge]) -> int:
    """The one person, people of the plan left out, who has all these relations."""
    annotations, frame = found.annotations, found.t0
    others = [track for track in annotations.uncovered_people(frame) if track not in found.people.values()]
    facts = {
        track: [annotations.related(edge.relation, found.people[edge.source], track, frame) for edge in edges]
        for track in others
    }
    for place, edge in enumerate(edges):
        could = sum(fact[place] != FALSE for fact in facts.values())
        found.check(could >= 2, f"{edge.relation!r} of {edge.source} alone leads to {edge.target}")
    into = {edge.target: edge.relation for edge in found.plan.edges}
    roads = [into.get(edge.source, "") for edge in edges]
    found.check(roads == sorted(set(roads)), "the branches begin alike, or are not in the order of their relations")
    result, person = only({track: conjunction(fact) for track, fact in facts.items()})
    if person is None:
        raise Undefined(result, f"no one person for certain is what {edges[0].target} is")
    return person


def _check_description(found: ResolvedPlan, conditions: tuple[Condition, ...]) -> None:
    annotations, t0 = found.annotations, found.t0
    for frame in sorted(found.stated.values()):
        found.check(frame in annotations.keyframes, f"frame {frame} is no keyframe")
    for condition in conditions:
        rest = [other for other in conditions if other is not condition]
        found.check(len(annotations.could_match(rest, t0)) >= 2, "the description has a condition too many")
    few = 1 <= len(conditions) <= found.rules.max_conditions
    found.check(few, f"the description has {len(conditions)} conditions")
    places = all(condition.attribute in ("sector", "distance") for condition in conditions)
    found.check(not places or not conditions, "a place alone is no description")
    if any(condition.attribute in ("gender", "age") for condition in conditions):
        visible = annotations.face_visible(found.people[found.plan.root], t0)
        found.check(visible, "gender or age describes somebody whose face is not visible")
    if found.template in ("change", "consequence"):
        posed = any(word in POSES for condition in conditions for word in actions_of(condition))
        found.check(not posed, "the description states a pose, which is the answer")
