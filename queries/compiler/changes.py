"""Frames at which people join or leave groups, as `schema.plan.GROUP_EVENTS` defines these events."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from jrdb_avr.schema.rules import KEYFRAME_STEP

States = Mapping[int, bool | None]
"""Whether a person is in a group, by the frame of each box in ascending order. None if it is unknown."""


class FirstChange(NamedTuple):
    """Possible frames of the first change, and whether the change is certain and only one frame is possible."""

    frames: tuple[int, ...]
    certain: bool


def read_states(boxes: Iterable[Mapping[str, Any]], memberships: Iterable[Mapping[str, Any]]) -> dict[int, States]:
    """Return the states of all people of a sequence, by track.

    Args:
        boxes: Rows of `reads/scene/boxes.cypher`.
        memberships: Rows of `reads/scene/memberships.cypher`.
    """
    frames: dict[int, list[int]] = defaultdict(list)
    for row in boxes:
        frames[row["who"]].append(row["frame"])
    states: dict[int, dict[int, bool | None]] = {who: dict.fromkeys(at) for who, at in frames.items()}
    groups: dict[int, list[Mapping[str, Any]]] = defaultdict(list)
    for row in memberships:
        groups[row["cluster"]].append(row)
    for rows in groups.values():
        for row in (row for row in rows if row["certain"] and row["who"] in frames):
            at = frames[row["who"]]
            span = at[bisect_left(at, row["first"]) : bisect_right(at, row["last"])]
            others = [rival for rival in rows if rival["who"] != row["who"] and _overlap(row, rival)]
            states[row["who"]] |= {frame: _state(others, frame) for frame in span}
    return dict(states)


def _overlap(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    return bool(first["first"] <= second["last"] and second["first"] <= first["last"])


def _state(others: Sequence[Mapping[str, Any]], frame: int) -> bool | None:
    certain = [rival["certain"] for rival in others if rival["first"] <= frame <= rival["last"]]
    return True if any(certain) else None if certain else False


def first_change(states: States, after: int, wanted: bool) -> FirstChange:
    """Find the first change of a person's state after a frame.

    Args:
        states: States of the person.
        after: Frame of the first box that counts, or an earlier frame.
        wanted: State after the change: True if the person joins a group.

    Returns:
        The frames at which the first change may be.

    >>> first_change({0: False, 15: None, 30: True}, 0, True)
    FirstChange(frames=(15, 30), certain=False)
    """
    frames: list[int] = []
    previous, decided = None, None
    for frame in (frame for frame in states if frame >= after):
        if previous is None or frame - previous > KEYFRAME_STEP:
            decided = None
        elif states[frame] is not (not wanted) and states[previous] is not wanted:
            frames.append(frame)
        # Between a known state and its opposite there is certainly a change, so later frames are impossible.
        if states[frame] is wanted and decided is (not wanted):
            return FirstChange(tuple(frames), len(frames) == 1)
        previous, decided = frame, decided if states[frame] is None else states[frame]
    return FirstChange(tuple(frames), certain=False)
