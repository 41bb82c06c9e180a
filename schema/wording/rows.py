"""What a row of the template table is: how a text's parts make its plan, and what a plan's text says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import msgspec

from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import Use


@dataclass(frozen=True, slots=True)
class Slots:
    """What a question's text says.

    conditions: of the described person; frames: the stated ones by time name; actions: those asked about, in the order
    of the row; relations: along the path, edge by edge (or the one that is counted).
    """

    conditions: tuple[Condition, ...]
    frames: dict[str, int]
    actions: tuple[str, ...] = ()
    relations: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Template:
    """A row of the table.

    times: the stated ones, that of the description first; events: the others, whose `action` is a number in braces that
    stands for the question's action; path: the edges, as pairs of nodes; uses: what each relation of the text is for.
    """

    template: str
    family: str
    times: tuple[str, ...]
    answer: AnswerSpec
    paraphrases: tuple[str, ...]
    events: Mapping[str, Time] = field(default_factory=dict)
    path: tuple[tuple[str, str], ...] = ()
    uses: tuple[Use, ...] = ()

    @property
    def actions(self) -> int:
        """How many actions the text asks about."""
        return len({time.action for time in self.events.values() if time.action is not None})

    def build(self, slots: Slots) -> Plan:
        """The plan that a text with these slots stands for."""
        named = {f"{{{number}}}": action for number, action in enumerate(slots.actions, 1)}
        events = {
            name: msgspec.structs.replace(time, action=named[time.action]) if time.action else time
            for name, time in self.events.items()
        }
        edges = tuple(
            Edge(source=source, relation=relation, target=target, at=self.times[0])
            for (source, target), relation in zip(self.path, slots.relations, strict=False)
        )
        answer = self.answer
        if self.uses == ("count",):
            answer = msgspec.structs.replace(answer, relation=slots.relations[0])
        people = ["a", *dict.fromkeys(target for _, target in self.path)]
        return Plan(
            root="a",
            target=answer.of,
            times={name: Time(frame=frame) for name, frame in slots.frames.items()} | events,
            nodes=tuple(Node(id=name, conditions=slots.conditions if name == "a" else ()) for name in people),
            edges=edges,
            answer=answer,
        )

    def slots(self, plan: Plan) -> Slots | None:
        """What the text of a plan of this row says; None where the plan lacks a part, so that it is of another row."""
        frames = {name: plan.times[name].frame for name in self.times if name in plan.times}
        actions = {
            time.action: plan.times[name].action
            for name, time in self.events.items()
            if time.action is not None and name in plan.times
        }
        counted = self.uses == ("count",)
        relations = (plan.answer.relation,) if counted else tuple(edge.relation for edge in plan.edges)
        root = next(node for node in plan.nodes if node.id == plan.root)
        slots = Slots(
            root.conditions,
            {name: frame for name, frame in frames.items() if frame is not None},
            tuple(action for _, action in sorted(actions.items()) if action is not None),
            tuple(relation for relation in relations if relation is not None),
        )
        found = len(slots.frames), len(slots.actions), len(slots.relations)
        return slots if found == (len(self.times), self.actions, len(self.uses)) else None
