"""The words of the questions: one template table, and its exact inverse.

`render` writes a plan as plain English, `parse` reads such a text back: `canonical(parse(render(t, p, key))[1])` is
`canonical(p)`. Both work from the same table: a template says which times and which action it needs, builds the plan
from these slots, and lists its paraphrases. Descriptions of people, times and actions are shared phrases, so a new
template is a new row. Left and right of a description are always the robot's, and say so.

Conditions stand in the order of `in_order`, whatever order the rules use to choose among descriptions.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec

from .errors import PlanError
from .plan import AnswerSpec, Condition, Node, Plan, Time, canonical
from .rules import FPS
from .vocabulary import POSES

ACTION_PHRASES: Final[dict[str, str]] = {
    "walking": "walking",
    "standing": "standing",
    "sitting": "sitting",
    "cycling": "cycling",
    "going upstairs": "going upstairs",
    "going downstairs": "going downstairs",
    "bending": "bending down",
    "skating": "skating",
    "scootering": "riding a scooter",
    "running": "running",
    "lying": "lying down",
    "holding sth": "holding something",
    "listening to someone": "listening to someone",
    "talking to someone": "talking to someone",
    "looking at robot": "looking at the robot",
    "looking into sth": "looking into something",
    "looking at sth": "looking at something",
    "typing": "typing",
    "interaction with door": "using a door",
    "eating sth": "eating something",
    "talking on the phone": "talking on the phone",
    "pointing at sth": "pointing at something",
    "reading": "reading",
    "pushing": "pushing something",
    "greeting gestures": "making a greeting gesture",
    "writing": "writing",
    "pulling": "pulling something",
}
"""Each action as an -ing phrase: fits after "is" and after "starts"."""

INTERACTION_PHRASES: Final[dict[str, str]] = {
    "walking together": "walking together with someone",
    "standing together": "standing together with someone",
    "conversation": "having a conversation with someone",
    "sitting together": "sitting together with someone",
    "going upstairs together": "going upstairs together with someone",
    "moving together": "moving along together with someone",
    "looking at robot together": "looking at the robot together with someone",
    "looking at sth together": "looking at something together with someone",
    "walking toward each other": "walking towards someone who comes the other way",
    "eating together": "eating together with someone",
    "going downstairs together": "going downstairs together with someone",
    "bending together": "bending down together with someone",
    "holding sth together": "holding something together with someone",
    "cycling together": "cycling together with someone",
    "interaction with door together": "using a door together with someone",
    "hugging": "hugging someone",
    "looking into sth together": "looking into something together with someone",
    "shaking hand": "shaking hands with someone",
    "waving hand together": "waving hands together with someone",
    "pointing at sth together": "pointing at something together with someone",
}
"""Each interaction, when the other person is anybody."""

_HEADS: Final[dict[tuple[str | None, str | None], str]] = {
    (None, None): "person",
    ("female", None): "woman or girl",
    ("male", None): "man or boy",
    (None, "childhood"): "child",
    ("female", "childhood"): "girl",
    ("male", "childhood"): "boy",
    (None, "adolescence"): "teenager",
    ("female", "adolescence"): "teenage girl",
    ("male", "adolescence"): "teenage boy",
    (None, "young adulthood"): "young adult",
    ("female", "young adulthood"): "young woman",
    ("male", "young adulthood"): "young man",
    (None, "middle adulthood"): "middle-aged person",
    ("female", "middle adulthood"): "middle-aged woman",
    ("male", "middle adulthood"): "middle-aged man",
    (None, "late adulthood"): "elderly person",
    ("female", "late adulthood"): "elderly woman",
    ("male", "late adulthood"): "elderly man",
}
"""(gender, age) -> noun."""

_SECTORS: Final = {
    "ahead": "ahead of {robot}",
    "right": "to {robot's} right",
    "behind": "behind {robot}",
    "left": "to {robot's} left",
}
_DISTANCES: Final = {
    "very close": "very close to {robot}",
    "close": "close to {robot}",
    "moderate": "at a moderate distance from {robot}",
    "far": "far from {robot}",
    "very far": "very far from {robot}",
}

_NUMBERS: Final = ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_ALONE: Final = "in no group"
_GROUP: Final = "in a group of "


@dataclass(frozen=True, slots=True)
class Slots:
    """What a question's text says: the description, the stated frames by time name, the action asked about."""

    conditions: tuple[Condition, ...]
    frames: dict[str, int]
    action: str | None = None


@dataclass(frozen=True, slots=True)
class Template:
    """A row of the table. `times` are the stated ones; `asks_action` marks those that name an action to look for."""

    family: str
    times: tuple[str, ...]
    asks_action: bool
    build: Callable[[Slots], Plan]
    paraphrases: tuple[str, ...]


# -- descriptions of a person ---------------------------------------------------------------------------------


def in_order(conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """The conditions in the order in which plans hold them: gender, age, pose, other actions, interaction, ..."""
    return tuple(sorted(conditions, key=lambda condition: (_rank(condition), msgspec.json.encode(condition))))


def _rank(condition: Condition) -> int:
    if condition.attribute is not None:
        return {"gender": 0, "age": 1, "group_size": 6, "sector": 7, "distance": 8}[condition.attribute]
    if condition.action is not None:
        return 2 if condition.action in POSES else 3
    return 4 if condition.object is not None else 5


def describe(conditions: Sequence[Condition]) -> str:
    """A noun phrase, as in "the only person to the robot's left who is sitting". Raises PlanError if there is none.

    >>> describe((Condition(action="sitting", at="t0"), Condition(attribute="distance", value="far", at="t0")))
    'the only person far from the robot who is sitting'
    """
    values: dict[str, str | int] = {}
    doing = []
    for condition in conditions:
        if condition.attribute is not None and condition.value is not None:
            if condition.attribute in values:
                raise PlanError("conditions", f"{condition.attribute} is given twice")
            values[condition.attribute] = condition.value
        elif condition.action is not None:
            doing.append(_phrase(ACTION_PHRASES, condition.action, "action"))
        elif condition.interaction is not None:
            doing.append(_phrase(INTERACTION_PHRASES, condition.interaction, "interaction"))
        else:
            raise PlanError("conditions", f"there are no words for the object {condition.object!r}")
    head = _HEADS.get((_text(values, "gender"), _text(values, "age")))
    if head is None:
        raise PlanError("conditions", f"there are no words for {values.get('gender')}, {values.get('age')}")
    place = _place(_text(values, "sector"), _text(values, "distance"))
    if "group_size" in values:
        doing.append(_group(values["group_size"]))
    clause = f"who is {_listed(doing)}" if doing else ""
    return " ".join(part for part in ("the only", head, place, clause) if part)


def _text(values: dict[str, str | int], name: str) -> str | None:
    value = values.get(name)
    return value if isinstance(value, str) else None


def _phrase(table: dict[str, str], name: str, kind: str) -> str:
    if name not in table:
        raise PlanError("conditions", f"there are no words for the {kind} {name!r}")
    return table[name]


def _listed(parts: list[str]) -> str:
    return " and ".join((", ".join(parts[:-1]), parts[-1])) if len(parts) > 1 else parts[0]


def _group(size: str | int) -> str:
    if not isinstance(size, int) or size < 1:
        raise PlanError("conditions", f"{size!r} is no size of a group")
    if size == 1:
        return _ALONE
    return _GROUP + (_NUMBERS[size - 2] if size - 2 < len(_NUMBERS) else str(size))


def _place(sector: str | None, distance: str | None) -> str:
    if (sector is not None and sector not in _SECTORS) or (distance is not None and distance not in _DISTANCES):
        raise PlanError("conditions", f"there are no words for the place {sector}, {distance}")
    first = _SECTORS[sector] if sector else ""
    second = _DISTANCES[distance] if distance else ""
    if first and second:
        second = second.replace("{robot}", "it")
    both = " and ".join(part for part in (first, second) if part)
    return both.replace("{robot}", "the robot").replace("{robot's}", "the robot's")


_ACTION_OF: Final = {phrase: action for action, phrase in ACTION_PHRASES.items()}
_INTERACTION_OF: Final = {phrase: label for label, phrase in INTERACTION_PHRASES.items()}
_PLACES: Final = {
    _place(sector, distance): (sector, distance) for sector in (None, *_SECTORS) for distance in (None, *_DISTANCES)
}


def _alternatives(phrases: Sequence[str]) -> str:
    # Longest first: "middle-aged person" must not stop at a shorter phrase that begins alike.
    return "|".join(re.escape(phrase) for phrase in sorted(phrases, key=lambda phrase: (-len(phrase), phrase)))


_PERSON: Final = re.compile(
    rf"the only (?P<head>{_alternatives(list(_HEADS.values()))})"
    rf"(?: (?P<place>{_alternatives([place for place in _PLACES if place])}))?"
    r"(?: who is (?P<state>.+))?"
)


def read_description(text: str, at: str) -> tuple[Condition, ...]:
    """The conditions of a noun phrase, holding at the time named `at`. Raises PlanError for any other text."""
    match = _PERSON.fullmatch(text)
    if match is None:
        raise PlanError("question", f"{text[:80]!r} describes nobody")
    gender, age = next(key for key, head in _HEADS.items() if head == match["head"])
    sector, distance = _PLACES[match["place"] or ""]
    conditions = [] if gender is None else [Condition(attribute="gender", value=gender)]
    if age is not None:
        conditions.append(Condition(attribute="age", value=age))
    if match["state"]:
        conditions += [_read_state(part, at) for part in re.split(", | and ", match["state"])]
    if sector is not None:
        conditions.append(Condition(attribute="sector", value=sector, at=at))
    if distance is not None:
        conditions.append(Condition(attribute="distance", value=distance, at=at))
    return in_order(conditions)


def _read_state(phrase: str, at: str) -> Condition:
    if phrase in _ACTION_OF:
        return Condition(action=_ACTION_OF[phrase], at=at)
    if phrase in _INTERACTION_OF:
        return Condition(interaction=_INTERACTION_OF[phrase], at=at)
    if phrase == _ALONE:
        return Condition(attribute="group_size", value=1, at=at)
    size = phrase.removeprefix(_GROUP)
    if size in _NUMBERS:
        return Condition(attribute="group_size", value=_NUMBERS.index(size) + 2, at=at)
    if phrase.startswith(_GROUP) and re.fullmatch("[1-9][0-9]{0,5}", size):
        return Condition(attribute="group_size", value=int(size), at=at)
    raise PlanError("question", f"{phrase[:80]!r} is nothing a person is in a question")


# -- times ----------------------------------------------------------------------------------------------------


def moment(frame: int) -> str:
    """A stated time: seconds from frame 0, and the frame.

    >>> moment(150)
    '10.0 s (frame 150)'
    """
    return f"{frame / FPS:.1f} s (frame {frame})"


_MOMENT: Final = r"\d{1,7}\.\d s \(frame (?P<%s>\d{1,7})\)"


# -- templates ------------------------------------------------------------------------------------------------


def _simple(slots: Slots, answer: AnswerSpec, events: dict[str, Time] | None = None) -> Plan:
    """A plan of one person "a" described at t0."""
    times = {name: Time(frame=frame) for name, frame in slots.frames.items()}
    return Plan(
        root="a",
        target="a",
        times=times | (events or {}),
        nodes=(Node(id="a", conditions=slots.conditions),),
        edges=(),
        answer=answer,
    )


def _change(slots: Slots) -> Plan:
    return _simple(slots, AnswerSpec(mode="multiple_choice", read="action", of="a", at="t1"))


def _presence(slots: Slots) -> Plan:
    return _simple(slots, AnswerSpec(mode="multiple_choice", read="presence", of="a", at=("t1", "t2")))


def _distance(slots: Slots) -> Plan:
    return _simple(slots, AnswerSpec(mode="multiple_choice", read="distance_change", of="a", at=("t0", "t1")))


def _start(slots: Slots) -> Plan:
    event = Time(event="start", of="a", action=slots.action, after="t0")
    return _simple(slots, AnswerSpec(mode="frame", read="start", of="a", at="t1"), {"t1": event})


def _span(slots: Slots) -> Plan:
    events = {
        "t1": Time(event="start", of="a", action=slots.action, after="t0"),
        "t2": Time(event="end", of="a", action=slots.action, after="t1"),
    }
    return _simple(slots, AnswerSpec(mode="span", read="span", of="a", at=("t1", "t2")), events)


TEMPLATES: Final[dict[str, Template]] = {
    "start": Template(
        "action_boundary",
        ("t0",),
        True,
        _start,
        (
            "Find {who} at {t0}. {At} which frame does that person start {action} for the first time after that?",
            "At {t0}, find {who}. Keep your eyes on that person: {at} which frame is the first time after that "
            "moment that the person starts {action}?",
            "Consider {who} at {t0}. {When}, for the first time after that moment, does that person start {action}? "
            "Give the frame.",
        ),
    ),
    "span": Template(
        "action_boundary",
        ("t0",),
        True,
        _span,
        (
            "Find {who} at {t0}. The first time after that moment that this person starts {action}: {at} which frame "
            "does it begin, and {at} which frame does it end?",
            "At {t0}, find {who}. Some time after that, this person starts {action} for the first time. {At} which "
            "frame does that begin, and {at} which frame does it end?",
            "Consider {who} at {t0}. From {about}which frame to {about}which frame does the first stretch of "
            "{action} that this person begins after that moment last?",
        ),
    ),
    "change": Template(
        "unique_anchor",
        ("t0", "t1"),
        False,
        _change,
        (
            "Find {who} at {t0}. What is that person's posture or movement at {t1}?",
            "At {t0}, find {who}. What is this person's posture or movement later, at {t1}?",
            "Consider {who} at {t0}. When the video has reached {t1}, what is that person's posture or movement?",
        ),
    ),
    "presence": Template(
        "unique_anchor",
        ("t0", "t1", "t2"),
        False,
        _presence,
        (
            "Find {who} at {t0}. At which of two later times is that person visible, if at any: the first is "
            "{t1}, the second is {t2}?",
            "At {t0}, find {who}. Can this person be seen at {t1}, at {t2}, at both times or at neither?",
            "Consider {who} at {t0}. Of the two moments {t1} and {t2}, at which, if any, is that person visible?",
        ),
    ),
    "distance": Template(
        "unique_anchor",
        ("t0", "t1"),
        False,
        _distance,
        (
            "Find {who} at {t0}. Compared with then, is that person at {t1} closer to the robot, farther from it, at "
            "about the same distance, or not in view?",
            "At {t0}, find {who}. How far from the robot is this person at {t1}, compared with that first moment: "
            "closer, farther, about the same, or not in view?",
            "Consider {who} at {t0}. Has that person's distance from the robot become smaller or larger at {t1}, is "
            "it about the same, or is the person not in view?",
        ),
    ),
}

_EXACT: Final = {"At": "At", "at": "at", "When": "When", "about": ""}
_ABOUT: Final = {"At": "At about", "at": "at about", "When": "About when", "about": "about "}
"""Words for events: the second set where an action is annotated once a second."""


def render(template: str, plan: Plan, key: str, about: bool = False) -> str:
    """The question's text; `key` (hex, as `question_key` gives it) picks the paraphrase.

    `about` marks a time that is asked for as approximate: True where the action layer is annotated once a second.
    Templates that ask for no event do not change with it. Raises PlanError for a plan that is not of the template,
    or for which there are no words.
    """
    row = TEMPLATES.get(template)
    if row is None:
        raise PlanError("template", f"{template!r} is no template; use one of {', '.join(TEMPLATES)}")
    slots = _slots(row, plan)
    if canonical(row.build(slots)) != canonical(plan):
        raise PlanError("plan", f"is no plan of the template {template!r}")
    if in_order(slots.conditions) != slots.conditions:
        raise PlanError("nodes[0].conditions", "must stand in the order that in_order gives")
    paraphrase = row.paraphrases[int(key[-8:], 16) % len(row.paraphrases)]
    return _fill(paraphrase, slots, about)


def _slots(row: Template, plan: Plan) -> Slots:
    frames = {name: time.frame for name, time in plan.times.items() if time.frame is not None}
    if set(frames) != set(row.times):
        raise PlanError("times", f"this template states {', '.join(row.times)}")
    actions = {time.action for time in plan.times.values() if time.action is not None}
    if len(actions) != (1 if row.asks_action else 0):
        raise PlanError("times", "the template asks about one action" if row.asks_action else "no event is asked about")
    root = next(node for node in plan.nodes if node.id == plan.root)
    return Slots(root.conditions, frames, min(actions, default=None))


def _fill(paraphrase: str, slots: Slots, about: bool) -> str:
    words = {name: moment(frame) for name, frame in slots.frames.items()}
    words |= _ABOUT if about else _EXACT
    if slots.action is not None:
        words["action"] = _phrase(ACTION_PHRASES, slots.action, "action")
    return paraphrase.format(who=describe(slots.conditions), **words)


def _pattern(paraphrase: str, about: bool) -> re.Pattern[str]:
    parts = re.split(r"\{(\w+)\}", paraphrase)
    pattern = re.escape(parts[0])
    for name, text in zip(parts[1::2], parts[2::2], strict=True):
        if name in _EXACT:
            pattern += re.escape((_ABOUT if about else _EXACT)[name])
        elif name in ("who", "action"):
            pattern += f"(?P<{name}>.+?)"
        else:
            pattern += _MOMENT % name
        pattern += re.escape(text)
    return re.compile(pattern)


_PATTERNS: Final = tuple(
    (name, paraphrase, about, _pattern(paraphrase, about))
    for name, row in TEMPLATES.items()
    for paraphrase in row.paraphrases
    for about in ((False, True) if row.asks_action else (False,))
)


def parse(text: str) -> tuple[str, Plan]:
    """The template and the plan of a question's text. Raises PlanError for a text that `render` cannot have written."""
    for name, paraphrase, about, pattern in _PATTERNS:
        match = pattern.fullmatch(text)
        if match is None:
            continue
        row = TEMPLATES[name]
        found = match.groupdict()
        frames = {time: int(found[time]) for time in row.times}
        action = _ACTION_OF.get(found["action"]) if row.asks_action else None
        if row.asks_action and action is None:
            continue
        slots = Slots(read_description(found["who"], "t0"), frames, action)
        # What was read must be what would be written: wrong seconds, or a list in another order, are not ours.
        if _fill(paraphrase, slots, about) == text:
            return name, row.build(slots)
    raise PlanError("question", f"{text[:80]!r} is no question of this benchmark")


# -- identity -------------------------------------------------------------------------------------------------


def question_key(sequence: str, target: int, plan: Plan) -> str:
    """64 hex digits that decide among paraphrases and near-duplicates: sha256 of sequence, target and plan."""
    return hashlib.sha256(f"{sequence}\n{target}\n{canonical(plan)}".encode()).hexdigest()


def question_id(
    sequence: str, family: str, template: str, question: str, choices: Sequence[str], answer_mode: str
) -> str:
    """16 hex digits of the public columns of a question, and of nothing else."""
    public = msgspec.json.encode([sequence, family, template, question, list(choices), answer_mode])
    return hashlib.sha256(public).hexdigest()[:16]


def stated_actions(plan: Plan) -> tuple[str, ...]:
    """The action words of the question: of the descriptions and of the events, sorted, each once."""
    words = {condition.action for node in plan.nodes for condition in node.conditions}
    words |= {time.action for time in plan.times.values()}
    return tuple(sorted(word for word in words if word is not None))


def stated_frames(plan: Plan) -> tuple[int, ...]:
    """The frames stated in the question, by the names of their times."""
    return tuple(time.frame for _, time in sorted(plan.times.items()) if time.frame is not None)
