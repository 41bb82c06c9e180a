"""What a plan asks for, as rows of the world tables."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from jrdb_avr.schema.beliefs import SlotRow
from jrdb_avr.schema.plan import Plan

NO_FRAME = -1


def slots_of(plan: Plan, episode: str) -> tuple[SlotRow, ...]:
    """The slots of a plan: each node with its conditions, the edges, and the read.

    A slot's `name` is the attribute (or action, object, interaction), the relation or the read; `value` what it is to
    be, and of the read the names of its times. `frame` is the stated frame at which it holds, -1 where there is none.
    """
    return tuple(
        msgspec.structs.replace(slot, id=f"{episode}/{number}", episode=episode, number=number)
        for number, slot in enumerate(_slots(plan))
    )


def _slots(plan: Plan) -> Iterator[SlotRow]:
    for node in plan.nodes:
        yield _slot("node", node.id)
        for condition in node.conditions:
            name, value = condition.wanted
            yield _slot("condition", node.id, name=name, value=value, frame=_frame(plan, condition.at))
    for edge in plan.edges:
        yield _slot("edge", edge.source, edge.target, edge.relation, frame=_frame(plan, edge.at))
    times = plan.answer.times
    yield _slot("read", plan.answer.of, name=plan.answer.read, value=", ".join(times), frame=_frame(plan, times[0]))


def _slot(kind: str, node: str, other: str = "", name: str = "", value: str = "", frame: int = NO_FRAME) -> SlotRow:
    return SlotRow("", "", 0, kind, node, other, name, value, frame)


def _frame(plan: Plan, time: str | None) -> int:
    frame = plan.times[time].frame if time is not None else None
    return NO_FRAME if frame is None else frame
