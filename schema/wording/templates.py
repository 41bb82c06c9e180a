"""The template table: which plan a template's words stand for, and its paraphrases.

A row is data. Its plan is put together from what the text says (`rows.Slots`): the description of "a", the stated
frames, the actions asked about and the relations along the path; `{1}` and `{2}` in a row stand for the first and
the second of the actions. A template with several forms, such as `gap`, has a row for each.

In paraphrases, `{who}` is the description, `{t0}` a stated time, `{action1}` an action; people along a path are
called A, B, C and D, and `{says1}`, `{the1}` and `{holds1}` are the first relation's phrases (`relations`), `{Says1}`
at the start of a sentence. `{At}`, `{at}`, `{When}`, `{How}` and `{about}` say "about" where a time is approximate.
"""

from __future__ import annotations

from typing import Final

from jrdb_avr.schema.plan import AnswerSpec, Time
from jrdb_avr.schema.wording.rows import Template


def _start(of: str, after: str = "t0", action: str = "{1}") -> Time:
    return Time(event="start", of=of, action=action, after=after)


_TWO_HOPS: Final = (("a", "b"), ("b", "c"))
_THREE_HOPS: Final = (*_TWO_HOPS, ("c", "d"))
_FORK: Final = (("a", "b"), ("a", "c"), ("b", "d"), ("c", "d"))

_FIND: Final = "Find {who} at {t0}; call that person A. At that moment, {says1}. {Says2}. "
_SCENE: Final = "In the scene at {t0}, A is {who}. {Says1}. {Says2}. "
_STEPS: Final = "At {t0}, find A, {who}; then B, {the1}; and then C, {the2}. "
_ANGLES: Final = (
    "Panorama angles are in degrees: 0 is behind the robot, 90 is to the robot's left, 180 is straight ahead of the "
    "robot and 270 is to the robot's right."
)

TEMPLATES: Final[dict[str, Template]] = {
    "start": Template(
        "start",
        "action_boundary",
        ("t0",),
        AnswerSpec(mode="frame", read="start", of="a", at="t1"),
        (
            "Find {who} at {t0}. {At} which frame does that person start {action1} for the first time after that?",
            "At {t0}, find {who}. Keep your eyes on that person from then on: {at} which frame does the person first "
            "start {action1}?",
            "Consider {who} at {t0}. {When} does that person first start {action1} after that moment? Give the frame.",
        ),
        events={"t1": _start("a")},
    ),
    "span": Template(
        "span",
        "action_boundary",
        ("t0",),
        AnswerSpec(mode="span", read="span", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. {At} which frame does this person start {action1} for the first time after that, and "
            "{at} which frame does the person stop again?",
            "At {t0}, find {who}. Keep your eyes on that person from then on: {at} which frame does the person's first "
            "spell of {action1} begin, and {at} which frame does it end?",
            "Consider {who} at {t0}. From {about}which frame to {about}which frame is that person {action1} for the "
            "first time after that moment?",
        ),
        events={"t1": _start("a"), "t2": Time(event="end", of="a", action="{1}", after="t1")},
    ),
    "change": Template(
        "change",
        "unique_anchor",
        ("t0", "t1"),
        AnswerSpec(mode="multiple_choice", read="action", of="a", at="t1"),
        (
            "Find {who} at {t0}. What is that person's posture or movement at {t1}?",
            "At {t0}, find {who}. What is this person's posture or movement later, at {t1}?",
            "Consider {who} at {t0}. When the video has reached {t1}, what is that person's posture or movement?",
        ),
    ),
    "presence": Template(
        "presence",
        "unique_anchor",
        ("t0", "t1", "t2"),
        AnswerSpec(mode="multiple_choice", read="presence", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. Look again at {t1} and at {t2}: at which of these two times, if at either, can that "
            "person be seen?",
            "At {t0}, find {who}. Can this person be seen later only at {t1}, only at {t2}, at both times or at "
            "neither?",
            "Consider {who} at {t0}. Of the two later moments {t1} and {t2}, at which is that person visible, if at "
            "either?",
        ),
    ),
    "distance": Template(
        "distance",
        "unique_anchor",
        ("t0", "t1"),
        AnswerSpec(mode="multiple_choice", read="distance_change", of="a", at=("t0", "t1")),
        (
            "Find {who} at {t0}. At {t1}, is that person closer to the robot than at that first moment, farther from "
            "it, at about the same distance, or not in view?",
            "At {t0}, find {who}. How far from the robot is this person at {t1}, compared with that first moment: "
            "closer, farther, about the same, or not in view?",
            "Consider {who} at {t0}. At {t1}, is that person's distance from the robot smaller than then, larger or "
            "about the same, or is the person not in view?",
        ),
    ),
    "two_hop": Template(
        "two_hop",
        "chain_2hop",
        ("t0",),
        AnswerSpec(mode="multiple_choice", read="action", of="c", at="t0"),
        (
            _FIND + "What is C's posture or movement then?",
            _SCENE + "What is C's posture or movement?",
            _STEPS + "What is C's posture or movement at that moment?",
        ),
        path=_TWO_HOPS,
        uses=("hop", "hop"),
    ),
    "three_hop": Template(
        "three_hop",
        "chain_3hop",
        ("t0",),
        AnswerSpec(mode="multiple_choice", read="action", of="d", at="t0"),
        (
            _FIND + "{Says3}. What is D's posture or movement then?",
            _SCENE + "{Says3}. What is D's posture or movement?",
            "At {t0}, find A, {who}; then B, {the1}; then C, {the2}; and then D, {the3}. What is D's posture or "
            "movement at that moment?",
        ),
        path=_THREE_HOPS,
        uses=("hop", "hop", "hop"),
    ),
    "fork_join": Template(
        "fork_join",
        "chain_fork_join",
        ("t0",),
        AnswerSpec(mode="multiple_choice", read="action", of="d", at="t0"),
        (
            _FIND + "Leaving A, B and C aside, D is the only person who is {holds3} and who is also {holds4}. "
            "What is D's posture or movement then?",
            _SCENE + "Apart from A, B and C there is only one person, D, who is {holds3} and also {holds4}. "
            "What is D's posture or movement?",
            "At {t0}, find A, {who}; then B, {the1}; and C, {the2}. Not counting these three, only one person is "
            "{holds3} and also {holds4}. What is that person's posture or movement?",
        ),
        path=_FORK,
        uses=("hop", "hop", "join", "join"),
    ),
    "action_search": Template(
        "action_search",
        "chain_hybrid",
        ("t0",),
        AnswerSpec(mode="frame_viewpoint", read="start_view", of="c", at="t1"),
        (
            _FIND + "{At} which frame does C start {action1} for the first time after that, and at which panorama "
            f"angle is C then? {_ANGLES}",
            _SCENE
            + "{When} does C first start {action1} after that moment, and in which direction from the robot is C "
            f"then? Give the frame and the panorama angle. {_ANGLES}",
            _STEPS + "Keep your eyes on C from then on: {at} which frame does C first start {action1}, and at which "
            f"panorama angle is C at that frame? {_ANGLES}",
        ),
        events={"t1": _start("c")},
        path=_TWO_HOPS,
        uses=("hop", "hop"),
    ),
    "later_pose": Template(
        "later_pose",
        "long_range",
        ("t0", "t1"),
        AnswerSpec(mode="multiple_choice", read="action", of="c", at="t1"),
        (
            _FIND + "What is C's posture or movement later, at {t1}?",
            _SCENE + "When the video has reached {t1}, what is C's posture or movement?",
            _STEPS + "Keep your eyes on C: what is C's posture or movement at {t1}?",
        ),
        path=_TWO_HOPS,
        uses=("hop", "hop"),
    ),
    "consequence": Template(
        "consequence",
        "long_range",
        ("t0",),
        AnswerSpec(mode="multiple_choice", read="next_action", of="a", at="t1"),
        (
            "Find {who} at {t0}. For some time after that, this person's posture or movement stays what it is at that "
            "moment. When it changes for the first time, what does it change to?",
            "At {t0}, find {who}. This person keeps the posture or movement of that moment for some time. Which "
            "posture or movement comes next?",
            "Consider {who} at {t0}. When that person's posture or movement at that moment comes to an end, which one "
            "follows it?",
        ),
        events={"t1": Time(event="end", of="a", after="t0")},
    ),
    "gap_starts": Template(
        "gap",
        "long_range",
        ("t0",),
        AnswerSpec(mode="number", read="seconds_between", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. After that moment, {about}how many seconds pass between the first time that this "
            "person starts {action1} and the first time that the person starts {action2}?",
            "At {t0}, find {who}. Keep your eyes on that person from then on: the person starts {action1}, and later "
            "starts {action2}, each for the first time since that moment. {How} many seconds lie between the two "
            "starts?",
            "Consider {who} at {t0}, and only what begins after that moment. {How} many seconds pass from when that "
            "person first starts {action1} until the same person first starts {action2}?",
        ),
        events={"t1": _start("a"), "t2": _start("a", action="{2}")},
    ),
    "gap_absence": Template(
        "gap",
        "long_range",
        ("t0",),
        AnswerSpec(mode="number", read="seconds_between", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. Later, this person goes out of view for the first time after that, and comes back "
            "after a while. {How} many seconds pass from when the person is last seen until the person is seen again?",
            "At {t0}, find {who}. Keep your eyes on that person: {about}how many seconds does the first absence from "
            "view after that moment last, from when the person is last seen to when the person is seen again?",
            "Consider {who} at {t0}. That person stays in view for some time, is then out of view, and is later in "
            "view again. {How} many seconds pass from the last moment in view before this first absence to the first "
            "moment in view after it?",
        ),
        events={
            "t1": Time(event="leaves", of="a", after="t0"),
            "t2": Time(event="returns", of="a", after="t1"),
        },
    ),
    "gap_count": Template(
        "gap",
        "long_range",
        ("t1", "t2"),
        AnswerSpec(mode="number", read="count", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t1}. From then until {t2}, how many other people are, at one moment or another, {holds1}?",
            "At {t1}, find {who}. Count all the other people who are {holds1} at any moment from then until {t2}. How "
            "many are there?",
            "Consider {who} at {t1}, and all the time from then until {t2}. How many different people, not counting "
            "the one described, are at some moment {holds1}?",
        ),
        uses=("count",),
    ),
}
"""Rows by name: that of the template, and for a template with several forms one of its own."""

FAMILIES: Final = {row.template: row.family for row in TEMPLATES.values()}
"""The twelve templates and their families."""
