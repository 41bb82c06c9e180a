"""Questions as text, and the text read back: `render` and its exact inverse `parse`, both over the template table.

Also the id of a question and the facts that its text states.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from string import Formatter
from typing import Any, Final

import msgspec

from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import ACTION_PHRASES, POSES_OF_INTERACTIONS
from jrdb_avr.schema.plan import Condition, Plan, canonical
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.templates import TEMPLATES, Slots, Template, forms_of
from jrdb_avr.schema.wording.people import ACTION_OF, describe, in_order, read_description
from jrdb_avr.schema.wording.phrases import POSES_OF_VERBS, phrase_of
from jrdb_avr.schema.wording.relations import Style, read_relations, relate

_EXACT: Final = {"At": "At", "at": "at", "When": "When", "How": "How", "about": ""}
_ABOUT: Final = {"At": "At about", "at": "at about", "When": "About when", "How": "About how", "about": "about "}
"""Words for events: the second set where an action is annotated once a second."""

_SIDES: Final = " For left and right, go by the middle of each person."
"""Follows where people are sought on a side as the robot sees it: boxes that overlap could be read in two ways."""

_IN_VIEW: Final = " Only people in clear view count (at least half of the person can be seen)."
"""Last sentence of a question if the rules judge who is in clear view."""

_VIEW_WORDS: Final = (
    ("in no group in the picture", "in no group with anybody else in clear view"),
    ("group in the picture", "group in clear view"),
    (" in the picture", " people in clear view"),
    ("at one moment or another, ", "at one moment or another, in clear view at that moment, "),
    (". How many are there?", ", in clear view at that moment. How many are there?"),
    (" are at some moment ", " are at some moment, in clear view at that moment, "),
)
"""Words of questions without and with the last sentence. The first pairs contain later ones, so the order matters."""

_COUNTED: Final = "that person"
"""What the described person is called where a relation is counted, and nobody has a letter."""


LONGEST: Final = 4000
"""The most characters of a question: several times what any needs, and few enough that any text is read quickly."""


def moment(frame: int) -> str:
    """A stated time: seconds from frame 0, and the frame.

    >>> moment(150)
    '10.0 s (frame 150)'
    """
    return f"{frame / FPS:.1f} s (frame {frame})"


_MOMENT: Final = re.compile(r"[0-9]{1,7}\.[0-9] s \(frame ([0-9]{1,7})\)")


def render(template: str, plan: Plan, key: str, about: bool = False, in_view: bool = False) -> str:
    """The question's text; `key` (hex, as `question_key` gives it) picks the paraphrase.

    `in_view` adds that only people in clear view count: True if the rules judge who is in clear view.

    `about` marks a time that the answer names as approximate: True where the action layer is annotated once a second.
    Templates that ask for no event do not change with it. Raises PlanError for a plan that is not of the template,
    or for which there are no words.
    """
    row, slots = form_of(template, plan)
    _check(row, slots)
    text = _fill(row, row.paraphrases[int(key[-8:], 16) % len(row.paraphrases)], slots, about) + _note(slots)
    text = _with_view(text) if in_view else text
    if len(text) > LONGEST:
        raise PlanError("nodes[0].conditions", f"make a text of {len(text)} characters; {LONGEST} are too many")
    return text


def form_of(template: str, plan: Plan) -> tuple[Template, Slots]:
    """The form of a template that a plan is of, and its slots. Raises PlanError where it is of none."""
    for row in forms_of(template):
        slots = row.slots(plan)
        if slots is not None and canonical(row.build(slots)) == canonical(plan):
            return row, slots
    raise PlanError("plan", f"is no plan of the template {template!r}")


def _check(row: Template, slots: Slots) -> None:
    """Refuse plans that say what another plan should say, or that none should: a question has exactly one plan."""
    if in_order(slots.conditions) != slots.conditions:
        raise PlanError("nodes[0].conditions", "must stand in the order that in_order gives")
    if any(condition.at not in (None, row.described) for condition in slots.conditions):
        raise PlanError("nodes[0].conditions", f"must hold at {row.described!r}, the time of the description")
    if len(set(slots.actions)) < len(slots.actions):
        raise PlanError("times", "the two actions that start are different ones")
    if row.joins:
        first, second, _, _ = slots.relations
        if first == second:
            raise PlanError("edges[1].relation", "must differ from that of edges[0], or both lead to one person")
        if first > second:
            raise PlanError("edges[0].relation", "must come before that of edges[1] in the alphabet")


# -- slots ----------------------------------------------------------------------------------------------------


@cache
def _pieces(paraphrase: str, about: bool) -> tuple[tuple[str, str], ...]:
    """(text, slot after it) of a paraphrase, with the words for events filled in; the last slot is empty."""
    words = _ABOUT if about else _EXACT
    pieces, text = [], ""
    for literal, slot, _, _ in Formatter().parse(paraphrase):
        text += literal
        if slot in words:
            text += words[slot]
        elif slot is not None:
            pieces.append((text, slot))
            text = ""
    return (*pieces, (text, ""))


_STYLES: Final[dict[str, Style]] = {"says": "says", "Says": "says", "the": "the", "holds": "holds"}


def _numbered(slot: str) -> tuple[str, int]:
    """`says2` -> ("says", 1)."""
    return slot[:-1], int(slot[-1]) - 1


def _names(row: Template, number: int) -> tuple[str, str]:
    """What the two people of a relation are called in the text."""
    if row.counts:
        return _COUNTED, ""
    source, target = row.edges[number]
    return source.upper(), target.upper()


def _note(slots: Slots) -> str:
    return _SIDES if any(RELATIONS[label].side for label in slots.relations) else ""


def _fill(row: Template, paraphrase: str, slots: Slots, about: bool) -> str:
    return "".join(text + _word(row, slots, slot) for text, slot in _pieces(paraphrase, about))


def _word(row: Template, slots: Slots, slot: str) -> str:
    if slot == "":
        return ""
    if slot == "who":
        return describe(slots.conditions)
    if slot in slots.frames:
        return moment(slots.frames[slot])
    kind, number = _numbered(slot)
    if kind == "action":
        return phrase_of(ACTION_PHRASES, slots.actions[number], "action")
    phrase = relate(slots.relations[number], row.uses[number], _STYLES[kind], *_names(row, number))
    return _raised(phrase) if kind == "Says" else phrase


def _raised(phrase: str) -> str:
    return phrase[0].upper() + phrase[1:]


def _with_view(text: str) -> str:
    """Return the text of a question in which only people in clear view count."""
    for words, view_words in _VIEW_WORDS:
        text = text.replace(words, view_words)
    return text + _IN_VIEW


# -- reading --------------------------------------------------------------------------------------------------


def parse(text: str) -> tuple[str, Plan]:
    """The template and the plan of a question's text. Raises PlanError for a text that `render` cannot have written."""
    if text.endswith(_IN_VIEW) and len(text) <= LONGEST:
        plain = text.removesuffix(_IN_VIEW)
        for words, view_words in _VIEW_WORDS:
            plain = plain.replace(view_words, words)
        if _with_view(plain) == text:
            return parse(plain)
    body = text.removesuffix(_SIDES)
    for row in TEMPLATES.values() if len(text) <= LONGEST else ():
        for paraphrase in row.paraphrases:
            for about in (False, True):
                if not body.endswith(_pieces(paraphrase, about)[-1][0]):
                    continue
                for found in _readings(row, _pieces(paraphrase, about), body):
                    slots = _slots(row, found)
                    # What was read must be what would be written; a list in another order, for example, would not be.
                    if _written(row, paraphrase, slots, about) == text:
                        return row.name, row.build(slots)
    raise PlanError("question", f"{text[:80]!r} is no question of this benchmark")


def _written(row: Template, paraphrase: str, slots: Slots, about: bool) -> str | None:
    try:
        _check(row, slots)
    except PlanError:
        return None
    return _fill(row, paraphrase, slots, about) + _note(slots)


def _slots(row: Template, found: dict[str, Any]) -> Slots:
    relations = {slot[-1]: value for slot, value in found.items() if slot[:-1] in _STYLES}
    return Slots(
        conditions=found["who"],
        frames={name: found[name] for name in row.stated},
        actions=tuple(value for slot, value in sorted(found.items()) if slot.startswith("action")),
        relations=tuple(value for _, value in sorted(relations.items())),
    )


def _readings(row: Template, pieces: tuple[tuple[str, str], ...], text: str) -> Iterator[dict[str, Any]]:
    """Every way to read a text along the pieces of a paraphrase: slot -> what stands there."""
    literal, slot = pieces[0]
    if not text.startswith(literal):
        return
    rest = text[len(literal) :]
    if not slot:
        if not rest:
            yield {}
        return
    for end in _ends(rest, pieces[1][0]):
        value = _read(row, slot, rest[:end])
        if value is not None:
            for others in _readings(row, pieces[1:], rest[end:]):
                yield {slot: value} | others


def _ends(text: str, literal: str) -> Iterator[int]:
    """Where a slot's words may end: before each place where the text that follows them stands."""
    place = text.find(literal, 1) if literal else len(text)
    while place > 0:
        yield place
        place = text.find(literal, place + 1) if literal else -1


@lru_cache(maxsize=1024)
def _person(words: str, at: str) -> tuple[Condition, ...] | None:
    """A description read, or None; remembered, as many paraphrases begin alike."""
    try:
        return read_description(words, at)
    except PlanError:
        return None


def _read(row: Template, slot: str, words: str) -> Any:
    """What a slot's words say, or None where they say nothing."""
    if slot == "who":
        return _person(words, row.described)
    if slot in row.stated:
        stated = _MOMENT.fullmatch(words)
        return int(stated[1]) if stated and moment(int(stated[1])) == words else None
    kind, number = _numbered(slot)
    if kind == "action":
        return ACTION_OF.get(words)
    table = read_relations(row.uses[number], _STYLES[kind], *_names(row, number))
    if kind == "Says":
        words = next((phrase for phrase in table if _raised(phrase) == words), "")
    return table.get(words)


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
