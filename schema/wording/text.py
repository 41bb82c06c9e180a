"""Conversion of plans into texts of questions (`render`), and the reverse conversion (`parse`).

Both use the table of templates. The module also computes the id of a question, and the actions that its text implies.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from string import Formatter
from typing import Any, Final

import msgspec

from jrdb_avr.schema.choice_labels import implied_actions
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import ACTION_PHRASES, POSES_OF_INTERACTIONS
from jrdb_avr.schema.plan import Condition, Plan, canonical
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.templates import TEMPLATES, Slots, Template, forms_of
from jrdb_avr.schema.things import POSES_OF_VERBS
from jrdb_avr.schema.wording.people import ACTION_OF, describe, in_order, read_description
from jrdb_avr.schema.wording.phrases import phrase_of
from jrdb_avr.schema.wording.relations import Style, read_relations, relate

_EXACT: Final = {"At": "At", "at": "at", "When": "When", "How": "How", "about": ""}
_ABOUT: Final = {"At": "At about", "at": "at about", "When": "About when", "How": "About how", "about": "about "}
"""Words of the slots for approximate times. The second table is used if actions are annotated once per second."""

_SIDES: Final = " For left and right, go by the middle of each person."
"""Sentence that follows a question with left or right as seen from the robot.

Without this sentence, a reader could order two overlapping people in either way.
"""

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
"""Pairs of a phrase and its replacement in a question that ends with `_IN_VIEW`.

They are replaced in this order, because earlier phrases contain later ones.
"""

_COUNTED: Final = "that person"
"""Name of the described person in questions that count people. These questions name no person by a letter."""

LONGEST: Final = 4000
"""Maximum number of characters of a question.

The longest questions need a fraction of it. The limit keeps `parse` fast for texts of any length.
"""


def moment(frame: int) -> str:
    """Return the text of a stated time: seconds after frame 0, and the frame.

    Args:
        frame: Frame.

    >>> moment(150)
    '10.0 s (frame 150)'
    """
    return f"{frame / FPS:.1f} s (frame {frame})"


_MOMENT: Final = re.compile(r"[0-9]{1,7}\.[0-9] s \(frame ([0-9]{1,7})\)")


def render(template: str, plan: Plan, key: str, about: bool = False, in_view: bool = False) -> str:
    """Return the text of a question.

    Args:
        template: Name of the template.
        plan: Plan of the question.
        key: Hexadecimal digits of `question_key`, which choose the paraphrase.
        about: Whether the time in the answer is approximate, because actions are annotated once per second. Templates
            without a time in the answer ignore it.
        in_view: Whether the text says that only people in clear view count. This is so if the load rules judge views.

    Raises:
        PlanError: If the plan is not of the template, or has no phrase for a part.
    """
    row, slots = form_of(template, plan)
    _check(row, slots)
    text = _fill(row, row.paraphrases[int(key[-8:], 16) % len(row.paraphrases)], slots, about) + _note(slots)
    text = _with_view(text) if in_view else text
    if len(text) > LONGEST:
        raise PlanError("nodes[0].conditions", f"make a text of {len(text)} characters; {LONGEST} are too many")
    return text


def form_of(template: str, plan: Plan) -> tuple[Template, Slots]:
    """Find the form of a template that a plan has.

    Args:
        template: Name of the template.
        plan: Plan of a question.

    Returns:
        The form and its slots.

    Raises:
        PlanError: If the plan has no form of the template.
    """
    for row in forms_of(template):
        slots = row.slots(plan)
        if slots is not None and canonical(row.build(slots)) == canonical(plan):
            return row, slots
    raise PlanError("plan", f"is no plan of the template {template!r}")


def _check(row: Template, slots: Slots) -> None:
    """Raise PlanError if the slots have no meaning, or if other slots are the normal form of the same question."""
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
    """Split a paraphrase into pairs of a text and the slot that follows it. The last slot is "".

    The words of slots for approximate times are part of the texts.
    """
    phrases = _ABOUT if about else _EXACT
    pieces, text = [], ""
    for literal, slot, _, _ in Formatter().parse(paraphrase):
        text += literal
        if slot in phrases:
            text += phrases[slot]
        elif slot is not None:
            pieces.append((text, slot))
            text = ""
    return (*pieces, (text, ""))


_STYLES: Final[dict[str, Style]] = {"says": "says", "Says": "says", "the": "the", "holds": "holds"}


def _numbered(slot: str) -> tuple[str, int]:
    """Split the name of a slot into its kind and its index from 0. `says2` gives ("says", 1)."""
    return slot[:-1], int(slot[-1]) - 1


def _names(row: Template, index: int) -> tuple[str, str]:
    """Return the names of the two people of a relation in the text."""
    if row.counts:
        return _COUNTED, ""
    source, target = row.edges[index]
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
    kind, index = _numbered(slot)
    if kind == "action":
        return phrase_of(ACTION_PHRASES, slots.actions[index], "action")
    phrase = relate(slots.relations[index], row.uses[index], _STYLES[kind], *_names(row, index))
    return _raised(phrase) if kind == "Says" else phrase


def _raised(phrase: str) -> str:
    return phrase[0].upper() + phrase[1:]


def _with_view(text: str) -> str:
    """Change the text of a question so that only people in clear view count."""
    for phrase, view_phrase in _VIEW_WORDS:
        text = text.replace(phrase, view_phrase)
    return text + _IN_VIEW


# -- reading --------------------------------------------------------------------------------------------------


def parse(text: str) -> tuple[str, Plan]:
    """Read the text of a question.

    Args:
        text: Text.

    Returns:
        The name of the template, and the plan.

    Raises:
        PlanError: If `render` cannot have written the text.
    """
    if text.endswith(_IN_VIEW) and len(text) <= LONGEST:
        plain = text.removesuffix(_IN_VIEW)
        for phrase, view_phrase in _VIEW_WORDS:
            plain = plain.replace(view_phrase, phrase)
        if _with_view(plain) == text:
            return parse(plain)
    body = text.removesuffix(_SIDES)
    for row in TEMPLATES.values() if len(text) <= LONGEST else ():
        for paraphrase in row.paraphrases:
            for about in (False, True):
                if not body.endswith(_pieces(paraphrase, about)[-1][0]):
                    continue
                for values in _readings(row, _pieces(paraphrase, about), body):
                    slots = _slots(row, values)
                    # The text must be the one of `render`. For example, a list must have the right order.
                    if _written(row, paraphrase, slots, about) == text:
                        return row.name, row.build(slots)
    raise PlanError("question", f"{text[:80]!r} is no question of this benchmark")


def _written(row: Template, paraphrase: str, slots: Slots, about: bool) -> str | None:
    try:
        _check(row, slots)
    except PlanError:
        return None
    return _fill(row, paraphrase, slots, about) + _note(slots)


def _slots(row: Template, values: dict[str, Any]) -> Slots:
    relations = {slot[-1]: value for slot, value in values.items() if slot[:-1] in _STYLES}
    return Slots(
        conditions=values["who"],
        frames={name: values[name] for name in row.stated},
        actions=tuple(value for slot, value in sorted(values.items()) if slot.startswith("action")),
        relations=tuple(value for _, value in sorted(relations.items())),
    )


def _readings(row: Template, pieces: tuple[tuple[str, str], ...], text: str) -> Iterator[dict[str, Any]]:
    """Yield each assignment of words to slots that makes the text fit the pieces of a paraphrase."""
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
    """Yield each possible end of a slot's words. An end is a position of the text that follows the slot."""
    end = text.find(literal, 1) if literal else len(text)
    while end > 0:
        yield end
        end = text.find(literal, end + 1) if literal else -1


@lru_cache(maxsize=1024)
def _person(phrase: str, at: str) -> tuple[Condition, ...] | None:
    """Return the conditions of a description, or None. The cache helps, because many paraphrases begin alike."""
    try:
        return read_description(phrase, at)
    except PlanError:
        return None


def _read(row: Template, slot: str, phrase: str) -> Any:
    """Return the value of the words in a slot, or None if they have no meaning."""
    if slot == "who":
        return _person(phrase, row.described)
    if slot in row.stated:
        stated = _MOMENT.fullmatch(phrase)
        return int(stated[1]) if stated and moment(int(stated[1])) == phrase else None
    kind, index = _numbered(slot)
    if kind == "action":
        return ACTION_OF.get(phrase)
    table = read_relations(row.uses[index], _STYLES[kind], *_names(row, index))
    if kind == "Says":
        phrase = next((text for text in table if _raised(text) == phrase), "")
    return table.get(phrase)


def question_key(sequence: str, target: int, plan: Plan) -> str:
    """Return 64 hexadecimal digits that choose a question's paraphrase, and one question among near-duplicates.

    Args:
        sequence: Name of the sequence.
        target: Track of the target.
        plan: Plan of the question.
    """
    return hashlib.sha256(f"{sequence}\n{target}\n{canonical(plan)}".encode()).hexdigest()


def question_id(
    sequence: str, family: str, template: str, question: str, choices: Sequence[str], answer_mode: str
) -> str:
    """Return the id of a question: 16 hexadecimal digits that depend only on the public columns.

    Args:
        sequence: Name of the sequence.
        family: Name of the family.
        template: Name of the template.
        question: Text of the question.
        choices: Texts of the choices.
        answer_mode: Name of the answer mode.
    """
    public = msgspec.json.encode([sequence, family, template, question, list(choices), answer_mode])
    return hashlib.sha256(public).hexdigest()[:16]


def actions_of(condition: Condition) -> tuple[str, ...]:
    """Return the actions that the words of a condition name.

    These are the action of the condition, or the poses that an interaction or verb implies.

    Args:
        condition: Condition of a description.

    >>> actions_of(Condition(interaction="sitting together", at="t0"))
    ('sitting',)
    """
    if condition.action is not None:
        return (condition.action,)
    if condition.interaction in POSES_OF_INTERACTIONS:
        return (POSES_OF_INTERACTIONS[condition.interaction],)
    return POSES_OF_VERBS.get(condition.verb or "", ())


@lru_cache(maxsize=4096)
def implied_choices(conditions: tuple[Condition, ...], labels: tuple[str, ...] = ()) -> frozenset[str]:
    """Return the actions that the words of a question state or imply. None of them is a choice of the question.

    Args:
        conditions: Conditions of the description.
        labels: Relations and actions of the text.
    """
    stated = (condition.action or condition.interaction or condition.verb for condition in conditions)
    return frozenset().union(*(implied_actions(word) for word in (*stated, *labels) if word is not None))


def stated_frames(plan: Plan) -> tuple[int, ...]:
    """Return the frames that a question states, sorted by the names of their times.

    Args:
        plan: Plan of the question.
    """
    return tuple(time.frame for _, time in sorted(plan.times.items()) if time.frame is not None)
