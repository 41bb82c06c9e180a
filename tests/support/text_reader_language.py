"""The words of a question, read by rules that share no code with the engine."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

FPS = 15

POSES = {
    "walking": "walking",
    "standing": "standing",
    "sitting": "sitting",
    "cycling": "cycling",
    "going upstairs": "going upstairs",
    "going downstairs": "going downstairs",
    "bending down": "bending",
    "skating": "skating",
    "riding a scooter": "scootering",
    "running": "running",
    "lying down": "lying",
}
ACTIONS = {phrase: {label} for phrase, label in POSES.items()} | {
    "holding something": {"holding sth"},
    "listening to someone": {"listening to someone"},
    "talking to someone": {"talking to someone"},
    "looking at the robot": {"looking at robot"},
    "looking into something": {"looking into sth"},
    "looking at something": {"looking at sth"},
    "typing": {"typing"},
    "using a door": {"interaction with door", "opening the door", "pushing the door", "holding the door"},
    "eating something": {"eating sth"},
    "talking on the phone": {"talking on the phone"},
    "pointing at something": {"pointing at sth"},
    "reading": {"reading"},
    "pushing something": {"pushing"},
    "pulling something": {"pulling"},
    "making a greeting gesture": {"greeting gestures"},
    "writing": {"writing"},
}
WIDER = {
    "walking": {"going upstairs", "going downstairs", "running", "bending"},
    "standing": {"bending", "scootering", "skating"},
    "sitting": {"cycling", "bending"},
    "looking at something": {"looking at robot", "looking into sth", "reading", "pointing at sth"},
    "looking into something": {"reading"},
    "holding something": {
        *("eating sth", "talking on the phone", "reading", "pushing", "pulling"),
        *("interaction with door", "opening the door", "pushing the door", "holding the door"),
    },
    "talking to someone": {"talking on the phone"},
    "listening to someone": {"talking on the phone"},
}
"""Labels that a reader may call by a phrase too, beside the phrase's own."""
WIDER_CHOICES = {
    "talking to someone": {"listening to someone"},
    "listening to someone": {"talking to someone"},
    "holding something": {"looking into sth", "typing", "writing"},
    "looking into something": {"typing", "writing", "sitting"},
    "typing": {"writing", "reading", "sitting"},
    "writing": {"typing", "reading", "sitting"},
    "cycling": {"scootering"},
    "skating": {"scootering"},
    "riding a scooter": {"cycling", "skating"},
}
"""Further labels that a reader may call by a phrase among the choices."""

WIDER_PARTNERS = {
    "moving together": {"walking together", "cycling together", "going upstairs together", "going downstairs together"},
    "walking together": {"going upstairs together", "going downstairs together"},
    "looking at sth together": {"looking at robot together", "looking into sth together"},
}
WIDER_VERBS = {
    "holding": {"carrying"},
    "carrying": {"holding"},
    "handling/manipulating": {"holding", "carrying", "using"},
    "using": {"handling/manipulating", "holding"},
    "looking at": {"looking into"},
}
WIDER_AGES = {
    "childhood": {"adolescence"},
    "adolescence": {"childhood", "young adulthood"},
    "young adulthood": {"adolescence", "middle adulthood"},
    "middle adulthood": {"young adulthood", "late adulthood"},
    "late adulthood": {"middle adulthood"},
}
"""Nobody sees the bound between two ages: a teenager may be called a child, or a young man or woman."""

PARTNERS = {
    "walking together with": "walking together",
    "standing together with": "standing together",
    "sitting together with": "sitting together",
    "going upstairs together with": "going upstairs together",
    "going downstairs together with": "going downstairs together",
    "moving along together with": "moving together",
    "looking at the robot together with": "looking at robot together",
    "looking at something together with": "looking at sth together",
    "looking into something together with": "looking into sth together",
    "pointing at something together with": "pointing at sth together",
    "eating together with": "eating together",
    "bending down together with": "bending together",
    "holding something together with": "holding sth together",
    "cycling together with": "cycling together",
    "using a door together with": "interaction with door together",
    "waving hands together with": "waving hand together",
    "having a conversation with": "conversation",
    "hugging": "hugging",
    "shaking hands with": "shaking hand",
    "walking towards": "walking toward each other",
}
AGES = {
    "child": "childhood",
    "teenager": "adolescence",
    "young adult": "young adulthood",
    "middle aged person": "middle adulthood",
    "elderly person": "late adulthood",
}
SIDES = {"left": 1, "right": -1}
AXES = {"ahead of the robot": 180, "to the robot's left": 90, "behind the robot": 0, "to the robot's right": 270}
AHEAD = {"in front of": 0, "front left": 1, "left": 2, "back left": 3, "behind": 4}


@dataclass(frozen=True)
class Reading:
    """One way to take the words that leave a choice; the values of `HELD`."""

    sector: int = 40
    beside: str = "centre"
    facing: str = "drawn"
    metres: str = "recorded"
    words: str = "label"
    group: str = "moment"
    seen: str = "clear"
    spell: str = "certain"
    pause: int = 8
    votes: str = "majority"
    partner: str = "in frame"
    age: str = "band"

    def __str__(self) -> str:
        own = [f"{word}={value}" for word, value in asdict(self).items() if value != asdict(Reading())[word]]
        return ", ".join(own) or "as defined"


HELD: dict[str, tuple] = {
    "sector": (40, 45, 90),
    "beside": ("centre", "visible"),
    "metres": ("recorded", "ground", "space"),
    "seen": ("clear", "box", "about"),
    "spell": ("certain", "possible"),
    "pause": (8, 30),
    "words": ("label", "wide"),
    "facing": ("drawn", "quarters", "halves", "eighths"),
    "age": ("band", "wide"),
    "votes": ("majority", "any"),
    "partner": ("in frame", "anybody"),
    "group": ("moment", "around"),
}
"""Readings under which every published question has one answer; the first is that of docs/definitions.md."""


TIME = r"\d+\.\d s \(frame (\d+)\)"
CLOCK = r"(\d+\.\d) s \(frame (\d+)\)"
SIZES = {"two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9, "ten": 10}
NOUNS = {"man or boy": ("male", ""), "woman or girl": ("female", ""), "person": ("", "")}
NOUNS |= {"boy": ("male", "childhood"), "girl": ("female", "childhood")}
NOUNS |= {"teenage boy": ("male", "adolescence"), "teenage girl": ("female", "adolescence")}
for _word, _age in (("young", "young"), ("middle-aged", "middle"), ("elderly", "late")):
    NOUNS |= {f"{_word} man": ("male", f"{_age} adulthood"), f"{_word} woman": ("female", f"{_age} adulthood")}
NOUNS |= {noun.replace("middle aged", "middle-aged"): ("", age) for noun, age in AGES.items()}
THINGS = {"television": "television", "statue": "statues", "display stand": "standee", "water bottle": "waterbottle"}
THINGS |= {"computer accessory": "peripheral", "skateboard or segway or hoverboard": "skateboard/segway/hoverboard"}
THINGS |= {"bicycle or scooter": "bicycle/scooter"}
VERBS = {"handling": "handling/manipulating", "talking on": "talking on", "looking at": "looking at"}
VIEW = " as seen from the robot"
IN_VIEW = " Only people in clear view count (at least half of the person can be seen)."
ONE_TRUE = " Only one is true."
BY_MIDDLES = " For left and right, go by the middle of each person."
METRES = r"\((?:([\d.]+) to ([\d.]+)|over ([\d.]+)|under ([\d.]+)) m\)"
FACING = r"(?:(in front of|behind) [A-D]|to [A-D]'s ((?:front |back )?(?:left|right)))"


class UnreadableError(Exception):
    """The text has words that the reader does not know."""


@dataclass(frozen=True)
class Condition:
    """What is true of one person: a method of `Facts`, its arguments, and the words."""

    fact: str
    values: tuple
    words: str


@dataclass(frozen=True)
class Link:
    """What leads from a person by name to another."""

    fact: str
    start: str
    values: tuple


@dataclass(frozen=True)
class Step:
    """A person by name, found by the links from earlier ones; `aside` are people left out."""

    name: str
    links: tuple[Link, ...]
    aside: tuple[str, ...] = ()


@dataclass(frozen=True)
class Question:
    """A question as it is understood: whom it is about, and what is to be read of the last person."""

    frame: int
    conditions: tuple[Condition, ...]
    steps: tuple[Step, ...]
    read: str
    values: tuple
    judged: bool = False
    """Whether only people in clear view count."""
    text: str = field(default="", compare=False)


# Descriptions.


def bounds(found: tuple[str | None, ...]) -> tuple[float, float]:
    low, high, over, under = (float(value) if value else 0.0 for value in found)
    return (over, math.inf) if over else (low, high or under)


def described(text: str) -> tuple[Condition, ...]:
    """Conditions of "teenager ahead of the robot who is sitting and in a group of two in the picture"."""
    noun = max((noun for noun in NOUNS if re.match(noun + r"\b", text)), key=len, default="")
    if not noun:
        raise UnreadableError(text)
    gender, age = NOUNS[noun]
    conditions = [Condition("attribute", ("gender", gender), gender)] if gender else []
    conditions += [Condition("attribute", ("age", age), age)] if age else []
    rest = text.removeprefix(noun)
    while rest:
        for form, make in PHRASES:
            if found := re.match(rf"(?: who is|, | and|,)? ?(?:{form})(?=$|,| and | who is )", rest):
                conditions.append(make(found))
                rest = rest[found.end() :]
                break
        else:
            raise UnreadableError(rest)
    return tuple(conditions)


def thing_of(words: str) -> str:
    name = re.sub(r"^(?:an?|some) ", "", words)
    return THINGS.get(name, name)


PHRASES: list[tuple[str, Callable[[re.Match], Condition]]] = [
    (f"({'|'.join(AXES)})", lambda found: Condition("in_sector", (AXES[found[1]],), found[1])),
    (
        rf"(?:very far from|far from|close to|very close to|at a moderate distance from) (?:the robot|it) {METRES}",
        lambda found: Condition("at_metres", bounds(found.groups()), "metres"),
    ),
    (
        r"in a group of (\w+) (?:in the picture|people in clear view)",
        lambda found: Condition("group_size", (SIZES.get(found[1]) or int(found[1]),), "in a group of N"),
    ),
    (
        r"in no group (?:in the picture|with anybody else in clear view)",
        lambda found: Condition("group_size", (1,), "in no group"),
    ),
    (
        rf"({'|'.join(PARTNERS)}) someone(?: who comes the other way)?",
        lambda found: Condition("with_someone", (PARTNERS[found[1]],), found[1] + " someone"),
    ),
    (f"({'|'.join(ACTIONS)})", lambda found: Condition("doing", (found[1],), found[1])),
    (
        r"(\w+ing(?: at| into| on| out)?) ((?:an?|some) (?:(?!,| and | who ).)+)",
        lambda found: Condition("handling", (VERBS.get(found[1], found[1]), thing_of(found[2])), found[0].strip()),
    ),
]


# Hops.


def linked(text: str) -> list[Link]:
    """Links of "the first person to the left of A as seen from the robot", "in the same group as B" and the like."""
    text = re.sub(
        r",? ?\(?from [A-D]'s own point of view\)?|, who comes the other way| while [A-D] walks towards them", "", text
    ).strip()
    if found := re.fullmatch(rf"the first person to the (left|right) of ([A-D]){VIEW}", text):
        return [Link("first_aside", found[2], (found[1],))]
    if found := re.fullmatch(r"the only other member of ([A-D])'s group in (?:the picture|clear view)", text):
        return [Link("same_group", found[1], ())]
    text = re.sub("^the only person (?:who is )?", "", text)
    if found := re.fullmatch(rf"within (\d+) degrees to the (left|right) of ([A-D]){VIEW}", text):
        return [Link("within", found[3], (found[2], float(found[1])))]
    if found := re.fullmatch(r"in the same group as ([A-D])", text):
        return [Link("same_group", found[1], ())]
    if found := re.fullmatch(rf"({'|'.join(PARTNERS)}) ([A-D])", text):
        return [Link("together", found[2], (PARTNERS[found[1]],))]
    place = rf"(?:very close to|close to|at a moderate distance from) ([A-D]) {METRES} and {FACING}"
    if found := re.fullmatch(place, text):
        name = found[1]
        return [Link("near", name, bounds(found.groups()[1:5])), Link("facing", name, (found[6] or found[7],))]
    raise UnreadableError(text)


def step(text: str) -> Step | None:
    """A person from a clause, None where it is none of a person."""
    if found := re.fullmatch(r"(?:and )?(?:then )?([B-D]),? (?:is )?(the (?:first|only) .+)", text):
        return Step(found[1], tuple(linked(found[2])))
    if found := re.fullmatch(
        r"([A-D]) and ([B-D]) are the only two members of their group in (?:the picture|clear view)", text
    ):
        return Step(found[2], (Link("same_group", found[1], ()),))
    if found := re.fullmatch(rf"([A-D]) is ({'|'.join(PARTNERS)}) exactly one person, ([B-D])", text):
        return Step(found[3], (Link("together", found[1], (PARTNERS[found[2]],)),))
    if found := re.fullmatch(r"([A-D]) and exactly one other person, ([B-D]), are walking towards each other", text):
        return Step(found[2], (Link("together", found[1], (PARTNERS["walking towards"],)),))
    joint = (
        r"(?:Leaving A, B and C aside, D is the only person|Apart from A, B and C there is only one person, D,|"
        r"Not counting these three, only one person) (?:who )?is (.+?) and (?:who is )?also (.+)"
    )
    if found := re.fullmatch(joint, text):
        return Step("D", (*linked(found[1]), *linked(found[2])), ("A", "B", "C"))
    return None


# The whole text.

AT = r"\d+\.\d s \(frame (?P<frame>\d+)\)"
AFTER = rf"; call that person A|, and only what begins after that moment|, and all the time from then until {TIME}"
OPENINGS = (
    rf"(?:Find|Consider) the only (?P<words>.+?) at {AT}(?:{AFTER})?",
    rf"At {AT}, find (?:A, )?the only (?P<words>.+)",
    rf"In the scene at {AT}, A is the only (?P<words>.+)",
)
PHRASE = rf"({'|'.join(sorted(ACTIONS, key=len, reverse=True))})"
GROUP = "in the same group as"
READS = (
    ("span", rf"first spell of {PHRASE} begin"),
    ("span", rf"start {PHRASE} for the first time after that, and at (?:about )?which frame does the person stop"),
    ("span", rf"[Ff]rom (?:about )?which frame to (?:about )?which frame is that person {PHRASE} for the first time"),
    ("starts", rf"starts {PHRASE}, and later starts {PHRASE}"),
    ("starts", rf"start(?:s|ing)? {PHRASE} .* start(?:s|ing)? {PHRASE}"),
    ("view", rf"start {PHRASE}\b.*panorama angle"),
    ("start", rf"start {PHRASE}\b"),
    ("absence", r"seconds.*(?:absence|seen again)"),
    ("count", rf"(?:Count all|[Hh]ow many) .*people.* ({GROUP}|{'|'.join(PARTNERS)}) that person"),
    ("next_pose", r"which of these does th(?:at|e) person do (?:next|first after that moment)\?"),
    ("distance", rf"{TIME}.*within a metre.*not in view"),
    ("presence", rf"{TIME}.*{TIME}.*(?:if at either|at neither)"),
    ("action", r"which of these is (?:[CD]|that person|this person) doing"),
)


def parse(text: str) -> Question:
    """What a question says, or `UnreadableError` naming the words that are not known."""
    for second, frame in re.findall(CLOCK, text):
        if abs(float(second) * FPS - int(frame)) > FPS / 20:
            raise UnreadableError(f"{second} s is not frame {frame}")
    said = text.replace(IN_VIEW, "", 1)
    body = said.removesuffix(BY_MIDDLES)
    if (body == said) == (VIEW in body):
        raise UnreadableError(f"{BY_MIDDLES} or not")
    asked = body.removesuffix(ONE_TRUE)
    sentences = [sentence.strip().rstrip(".") for sentence in re.split(r"(?<=[.])\s+(?=[A-Z])", asked)]
    clauses = sentences[0].split("; ")
    if len(clauses) > 1 and clauses[1] == "call that person A":
        clauses = clauses[:1]
    opening = next((found for form in OPENINGS if (found := re.fullmatch(form, clauses[0]))), None)
    if opening is None:
        raise UnreadableError(clauses[0])
    steps, rest = [], []
    for clause in [*clauses[1:], *sentences[1:]]:
        clause = clause.removeprefix("At that moment, ")
        made = None if rest else step(clause)
        if made:
            steps.append(made)
        else:
            rest.append(clause)
    tail = ". ".join(rest)
    matches = ((read, match) for read, form in READS if (match := re.search(form, tail, re.IGNORECASE)))
    read, match = next(matches, ("", None))
    if match is None or (read in ("action", "next_pose")) == (asked == body):
        raise UnreadableError(tail)
    values = tuple(int(group) if group.isdigit() else group for group in match.groups() if group)
    if read == "action" and (later := re.search(TIME, tail)):
        values = (int(later[1]),)
    if read == "count":
        values = (*values, int(re.findall(TIME, text)[-1]))
    who = described(opening["words"])
    return Question(int(opening["frame"]), who, tuple(steps), read, values, said != text, text)
