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
