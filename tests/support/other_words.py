"""Worlds in other words: labels that may be said of the same people in ordinary words, near each other.

`in_other_words(make)` is a maker of worlds as `make`: every person of its worlds keeps one wording of each label.
"""

from __future__ import annotations

import random

WORDINGS = {
    "walking": ("walking", "running", "going upstairs", "bending", "going downstairs"),
    "standing": ("standing", "standing", "bending", "scootering", "skating"),
    "sitting": ("sitting", "sitting", "cycling", "bending"),
    "reading": ("reading", "looking at sth", "holding sth", "looking at robot", "talking on the phone"),
    "eating sth": ("eating sth", "holding sth", "looking into sth"),
    "talking to someone": ("talking to someone", "talking on the phone"),
    "conversation": ("conversation", "looking at robot together", "looking at sth together"),
    "walking together": ("walking together", "moving together", "going upstairs together", "cycling together"),
    "looking_at something together": ("looking_at something together", "looking into sth together"),
    "holding": ("holding", "carrying", "using", "handling/manipulating"),
    "looking_into": ("looking_into", "looking_at"),
    "Young_Adulthood": ("Young_Adulthood", "adolescent", "middle_aged", "Late_Adulthood"),
    "Middle_Adulthood": ("Middle_Adulthood", "Late_Adulthood", "child"),
}


def in_other_words(make):
    """A maker of worlds that calls what people do by other words of the same family."""

    def made(rng, name):
        world = make(rng, name)
        words = random.Random(rng.getrandbits(64))
        wordings = {}

        def said(track, label):
            if label not in WORDINGS:
                return label
            if (track, label) not in wordings:
                wordings[track, label] = words.choice(WORDINGS[label])
            return wordings[track, label]

        def worded(value, track):
            if isinstance(value, list):
                return [worded(one, track) for one in value]
            if not isinstance(value, dict):
                return value
            return {said(track, key): worded(one, track) for key, one in value.items()}

        layers = {
            layer: {frame: [worded(row, row.get("label_id")) for row in rows] for frame, rows in content.items()}
            if layer in ("2d", "social", "reasoning")
            else content
            for layer, content in world[name].items()
        }
        return {name: layers}

    return made
