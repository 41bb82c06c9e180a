"""Words that the oracle knows: written out again from the definitions, as data."""

from __future__ import annotations

POSES = {
    "walking",
    "standing",
    "sitting",
    "cycling",
    "going upstairs",
    "going downstairs",
    "bending",
    "skating",
    "scootering",
    "running",
    "lying",
}
OTHERS = {
    "holding sth",
    "listening to someone",
    "talking to someone",
    "looking at robot",
    "looking into sth",
    "looking at sth",
    "typing",
    "interaction with door",
    "eating sth",
    "talking on the phone",
    "pointing at sth",
    "reading",
    "pushing",
    "greeting gestures",
    "writing",
    "pulling",
}
ACTIONS = POSES | OTHERS
TOGETHER = tuple(
    """walking together|standing together|conversation|sitting together|going upstairs together|moving together|
    looking at robot together|looking at sth together|walking toward each other|eating together|
    going downstairs together|bending together|holding sth together|cycling together|interaction with door together|
    hugging|looking into sth together|shaking hand|waving hand together|pointing at sth together""".replace(
        "\n    ", ""
    ).split("|")
)
VERBS = set(
    """working|opening|closing|entering|exiting|touching|cleaning|watering|pruning|planting|pushing|pulling|carrying|
    holding|looking at|looking into|looking out|presenting|organizing|leaning|painting|installing|removing|repairing|
    riding|parking|mounting|depositing|placing|warning|blocking|adjusting|constructing|maintaining|
    handling/manipulating|accessing|inspecting|storing|pressing|switching|drinking|refilling|moving|operating|
    displaying|arranging|talking on|browsing/engaging|loading|unloading|transporting|connecting|using|configuring|
    disconnecting|printing/copying|identifying|locating|promoting|advertising|finding_something|putting_something|
    directing|attracting|investigating|exploring|utilizing|understanding|observing|turning|wearing|adorning|replacing|
    matching|collecting|folding|servicing|feeding|climbing|going down|going up""".replace("\n    ", "").split("|")
)
POSTURES = {"sitting", "walking", "standing", "running"}
"""Verbs of the files that no question uses."""
PERSON_CATEGORIES = {"pedestrian", "bicyclist/rider", "child"}
AGES = ("childhood", "adolescence", "young adulthood", "middle adulthood", "late adulthood")

_SAID_TOO = """
going upstairs: walking
going downstairs: walking
running: walking
walking: running
bending: walking, standing, sitting
cycling: sitting
scootering: standing
skating: standing
looking at robot: looking at sth
looking into sth: looking at sth
reading: looking at sth, looking into sth, holding sth
eating sth: holding sth
pushing: holding sth
pulling: holding sth
interaction with door: holding sth
pointing at sth: looking at sth
talking on the phone: holding sth, talking to someone, listening to someone
walking together: moving together
cycling together: moving together
going upstairs together: moving together, walking together
going downstairs together: moving together, walking together
looking at robot together: looking at sth together
looking into sth together: looking at sth together
carrying: holding, handling/manipulating
holding: carrying, using, handling/manipulating
using: handling/manipulating, utilizing
utilizing: using
transporting: carrying
observing: looking at
looking at: observing
handling/manipulating: using
looking into: looking at
"""
SAID_TOO = {
    label: others.split(", ") for label, others in (line.split(": ") for line in _SAID_TOO.strip().splitlines())
}
"""What else may be said in ordinary words of whoever has a label: of them it is unknown, if it is not written."""


def said_too(difficulties):
    """{label: difficulty} as written, and what may be said beside it, which nobody can be sure of."""
    also = {other: None for label in difficulties for other in SAID_TOO.get(label, ())}
    return also | difficulties
