"""Which actions may be choices of a question, by brute force over the raw labels and the rules of docs/definitions.md.

It works on an `oracle_facts.Oracle` and shares no code with the engine: tables and rules are written out again.
"""

import itertools

from oracle_files import ACTIONS, POSES, SAID_TOO

YES, NO, MAYBE = "true", "false", "unknown"

NEVER = {
    *("looking at robot", "looking at sth", "pointing at sth", "interaction with door", "greeting gestures"),
    *("reading", "pulling"),
}
_CALLED = """
talking to someone: listening to someone
listening to someone: talking to someone
looking into sth: holding sth, reading
typing: looking into sth, holding sth, writing
writing: looking into sth, holding sth, typing, reading
reading: writing, typing
cycling: scootering
scootering: cycling, skating
skating: scootering
sitting: looking into sth, typing, reading, writing
"""
CALLED = {label: set(SAID_TOO.get(label, ())) for label in ACTIONS}
for _line in _CALLED.strip().splitlines():
    _label, _others = _line.split(": ")
    CALLED[_label] |= set(_others.split(", "))

_IMPLIED = """
conversation: talking to someone, listening to someone
eating together: eating sth
holding sth together: holding sth
looking into sth together: looking into sth
looking at sth together: looking at sth
looking into: looking into sth
looking at: looking at sth
observing: looking at sth
talking on: talking on the phone
holding: holding sth
carrying: holding sth
transporting: holding sth
handling/manipulating: holding sth
using: holding sth
utilizing: holding sth
drinking: holding sth
riding: cycling, skating, scootering
climbing: going upstairs
going up: going upstairs
going down: going downstairs
walking toward each other: walking
"""
IMPLIED = {line.split(": ")[0]: set(line.split(": ")[1].split(", ")) for line in _IMPLIED.strip().splitlines()}
IMPLIED |= {f"{pose} together": {pose} for pose in POSES} | {label: {label} for label in ACTIONS}


def same(one, other):
    """Whether two actions may be called the same, in either direction."""
    return one == other or other in CALLED[one] or one in CALLED[other]


def implied(words):
    """The actions that labels and verbs of a question state, and those that may be called so."""
    stated = set().union(*(IMPLIED.get(word, ()) for word in words))
    return {label for label in ACTIONS if label in stated or CALLED[label] & stated}


def labels(world, frame, track):
    """{label: difficulty} of a person's own labels at a keyframe."""
    return world.written.get((frame, track), {}) if frame in world.keyframes else {}


def sure(world, frame, track):
    """The labels that are certain at a keyframe, whatever the view."""
    found = labels(world, frame, track)
    poses = [label for label in found if label in POSES]
    whole = found and world.people[frame, track]["has_actions"] and len(poses) == 1
    return {label for label, code in found.items() if code in (1, 2) and (whole or label not in POSES)}


def doing(world, frame, track, action):
    """Whether somebody does it, for choices and proofs."""
    if (frame, track) not in world.people or world.covered(frame, track):
        return MAYBE
    found = world.written[frame, track]
    if action in sure(world, frame, track):
        return YES
    if (
        not world.people[frame, track]["has_actions"]
        or action in found
        or any(action in CALLED.get(one, ()) for one in found)
    ):
        return MAYBE
    return NO if action not in POSES or sure(world, frame, track) & POSES else MAYBE


def true_choices(world, frame, track):
    """What may be the right choice at a keyframe."""
    around = sure(world, frame - 15, track) | sure(world, frame + 15, track)
    return {label for label in around & ACTIONS - NEVER if doing(world, frame, track, label) == YES}


def false_choices(world, frame, track):
    """What may be wrong choices at a keyframe."""

    def near(action):
        seconds = 1 if action in POSES else 3
        return any(action in labels(world, frame + 15 * by, track) for by in range(-seconds, seconds + 1))

    return {a for a in ACTIONS - NEVER if doing(world, frame, track, a) == NO and not near(a)}


def shown_actions(world):
    """What is certainly done by a person in clear view at a keyframe."""
    clear = [(f, track) for f in world.keyframes for track in world.in_frame(f) if world.clear(f, track)]
    return set().union(*(sure(world, *key) for key in clear)) & ACTIONS


def wrong_sets(world, frame, track, truth, words, among=ACTIONS):
    """Every three wrong choices beside a right one; `words` are those of the question, `among` what may be a choice."""
    may = {*among} & world.shown_actions - implied(words)
    if truth not in may:
        return []
    wrong = [one for one in sorted(false_choices(world, frame, track) & may) if not same(one, truth)]
    return [
        three
        for three in itertools.combinations(wrong, 3)
        if not any(same(one, other) for one, other in itertools.combinations(three, 2))
    ]
