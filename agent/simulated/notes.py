"""The reference agent's graph as the marker's memory: what was written of each person, as looks and sightings again.

The world model is all that a turn knows of the turns before it. Somebody is named after the identity of the mark, so
that who is read again is the same entity; a mark is put together again from the attributes written at a frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Final

import msgspec

from jrdb_avr.agent.simulated.requests import Look, Request, Sighting
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, center_angle, crop_left, to_crop

_FrameId = Annotated[str, msgspec.Meta(pattern="^[0-9]{6}$")]
_PREFIX: Final = "p"
_UNTOLD: Final = ("", "")
"""Stands for the actions of somebody of whom not all were written down: any other may be true as well."""


class _Observation(msgspec.Struct):
    observation: str
    frame_id: _FrameId
    angle_deg: float | None = None


class _Seen(msgspec.Struct):
    observation: str
    frame_id: _FrameId
    box: tuple[float, float, float, float]


class _Attribute(msgspec.Struct):
    name: str
    value: str | float
    frame_id: _FrameId | None = None


class _Entity(msgspec.Struct):
    id: str
    node: str | None = None
    sightings: list[_Seen] = []
    attributes: list[_Attribute] = []


class _Relation(msgspec.Struct):
    source: str
    name: str
    target: str
    frame_id: _FrameId


class _Graph(msgspec.Struct):
    observations: list[_Observation] = []
    entities: list[_Entity] = []
    relations: list[_Relation] = []


# Made at import: threads that meet a type first at the same time crash the decoder.
_GRAPH: Final = msgspec.json.Decoder(_Graph)


@dataclass(frozen=True)
class Notes:
    """What a turn knows: `looks` in the order in which they were made, `newest` of them with their pictures.

    In a look without its picture only those are seen who were written down. `holders` says whose entity each node of
    the plan is, `told` holds (entity, name, value, frame or None) and `ties` (source, relation, target, frame).
    """

    looks: tuple[Look, ...]
    newest: tuple[Look, ...]
    holders: Mapping[str, int]
    sighted: frozenset[tuple[str, str]]
    told: frozenset[tuple[str, str, str | float, int | None]]
    ties: frozenset[tuple[str, str, str, int]]

    def of(self, identity: int, frame: int) -> Sighting | None:
        """A person at a frame, if seen there; of several sightings one that shows the box whole."""
        found = [seen for look in self.looks if look.frame == frame and (seen := look.of(identity)) is not None]
        return max(found, key=lambda seen: (seen.whole, seen.complete), default=None)

    def look_of(self, seen: Sighting) -> Look:
        """The look that a sighting comes from."""
        return next(look for look in self.looks if any(other is seen for other in look.sightings))


def entity_name(identity: int) -> str:
    """What the person with this mark is called in the graph."""
    return f"{_PREFIX}{identity}"


def _identity(name: str) -> int | None:
    number = name.removeprefix(_PREFIX)
    return int(number) if name.startswith(_PREFIX) and number.isascii() and number.isdigit() else None


def read_notes(request: Request) -> Notes:
    """The notes of a turn of the reference agent. Raises DecodeError for a graph that cannot be read."""
    try:
        graph = _GRAPH.decode(request.line("Graph: ") or "{}")
    except msgspec.DecodeError as error:
        raise DecodeError(f"the prompt's graph cannot be read: {error}") from None
    shown = {look.name: look for look in request.looks}
    people = [(identity, entity) for entity in graph.entities if (identity := _identity(entity.id)) is not None]
    looks = tuple(shown.get(made.observation) or _remembered(made, people) for made in graph.observations)
    return Notes(
        looks,
        tuple(look for look in looks if look.name in shown),
        {entity.node: identity for identity, entity in people if entity.node is not None},
        frozenset((entity.id, seen.observation) for _, entity in people for seen in entity.sightings),
        frozenset((entity.id, a.name, a.value, _frame(a.frame_id)) for _, entity in people for a in entity.attributes),
        frozenset((tie.source, tie.name, tie.target, int(tie.frame_id)) for tie in graph.relations),
    )


def _order(observation: str) -> int:
    """Observations are numbered as they are made."""
    digits = "".join(filter(str.isdigit, observation))
    return int(digits or 0)


def _frame(frame_id: str | None) -> int | None:
    return None if frame_id is None else int(frame_id)


def _remembered(made: _Observation, people: Sequence[tuple[int, _Entity]]) -> Look:
    """A look whose picture is gone: those who were written down in it."""
    frame, panorama = int(made.frame_id), made.angle_deg is None
    left = 0 if made.angle_deg is None else int(crop_left(made.angle_deg))
    width = WIDTH if panorama else CROP
    sightings = []
    for identity, entity in people:
        for seen in entity.sightings:
            if int(seen.frame_id) != frame:
                continue
            box = Box(*seen.box)
            place = box if panorama else to_crop(box, left)
            # Who was looked at again, to be seen whole, was seen here as well.
            again = _order(seen.observation) > _order(made.observation) and 0 <= place.x + place.w / 2 < width
            if again or seen.observation == made.observation:
                angle = center_angle(box.x, box.w)
                shown = place if panorama else _cut(place)
                sightings.append(Sighting(frame, _mark(identity, entity, frame), shown, False, angle, width))
    angle = 180.0 if made.angle_deg is None else made.angle_deg
    return Look(frame, angle, tuple(sightings), panorama, made.observation, left, width)


def _cut(box: Box) -> Box:
    """A crop's box that ends at its edge was cut off there, as boxes are written inside their picture."""
    right = box.x + box.w
    left = -1.0 if box.x < 1 else box.x
    return box._replace(x=left, w=(CROP + 1.0 if right > CROP - 1 else right) - left)


def _mark(identity: int, entity: _Entity, frame: int) -> Mark:
    """What was written of somebody at a frame, as a mark; nothing is known to be false of it but another pose."""
    told: dict[str, list[str | float]] = {}
    for attribute in entity.attributes:
        if attribute.frame_id is None or int(attribute.frame_id) == frame:
            told.setdefault(attribute.name, []).append(attribute.value)

    def text(name: str) -> str | None:
        return next((str(value) for value in reversed(told.get(name, []))), None)

    actions = [str(value) for value in told.get("action", [])]
    metres = next((value for value in told.get("distance_m", []) if isinstance(value, float)), None)
    verb, _, thing = (text("object") or "").partition(": ")
    return Mark(
        identity,
        gender=text("gender"),
        age=text("age"),
        pose=next((action for action in actions if action in POSES), None),
        actions=(*(action for action in actions if action not in POSES), *_UNTOLD),
        distance_dm=None if metres is None else round(metres * 10),
        interaction=text("interaction"),
        object=thing or None,
        verb=verb or None,
    )
