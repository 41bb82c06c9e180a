"""Phrases of questions, the raw labels that they stand for, and the ordinary ways to take them.

The phrases are those seen in published texts; nothing here comes from the wording of the program.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

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
    """One way to take the words that leave a choice; the values of `HELD` and `OPEN`."""

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
    moment: str = "label"

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

OPEN: dict[str, tuple] = {
    "moment": ("between",),
}
"""Further readings, under which some published questions have another answer or none: what is left to widen."""
