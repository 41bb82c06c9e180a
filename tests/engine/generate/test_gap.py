"""Counts of people who are met between keyframes, in worlds that are labelled at every frame."""

import random

from keyframe_layers import make_prover, proposals, searched
from loaded_stores import memory_store
from worlds import member, person

from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

NAME = "yard-2020-01-01_0"
FORMS = [template for template in TEMPLATES.values() if template.name == "gap"]
RULES = Rules(gap_min_s=2.0, count_min=2, long_wait_s=4.0, min_wait_s=1.0)
"""Easier than the real ones, so that small worlds hold many questions."""


def busy_world(rng):
    """People who come and go, begin and end things, change groups and talk; once a second, or at every frame."""
    step, length = rng.choice(((15, 24), (15, 24), (1, 14)))
    silent = 0.004 if step == 15 else rng.choice((0.0, 0.001))
    # Between keyframes a hard label of somebody whose own list is missing would be one or the other.
    hard = 0.0 if step == 1 and silent else 0.02
    people = {
        track: {"x": rng.uniform(0, 3760), "pose": "standing", "extra": None, "here": True, "group": 1, "talks": set()}
        for track in range(1, rng.randrange(4, 8))
    }
    layers = {"2d": {}, "social": {}}
    for second in range(length):
        for track, life in people.items():
            life["here"] = life["here"] if rng.random() < 0.9 else not life["here"]
            if rng.random() < 0.12:
                life["pose"] = rng.choice(("walking", "standing", "sitting"))
            if rng.random() < 0.15:
                life["extra"] = rng.choice((None, "reading", "eating sth"))
            if rng.random() < 0.04:
                life["group"] = rng.choice((1, 1, 2))
            if rng.random() < 0.3:
                life["talks"] = {rng.choice(sorted(people)) for _ in range(rng.randrange(3))} - {track}
            life["x"] += rng.uniform(-30, 30)
        for frame in range(15 * second, 15 * second + 15, step):
            if rng.random() < (0.02 if step == 15 else 0.004):
                continue
            rows, lists = layers["2d"].setdefault(frame, []), layers["social"].setdefault(frame, [])
            for track, life in people.items():
                if not life["here"] or (step == 1 and rng.random() < 0.01):
                    continue
                actions = {life["pose"]: 3 if rng.random() < 0.01 else 1} | (
                    {life["extra"]: 1} if life["extra"] else {}
                )
                box = (round(life["x"] % 3760, 1), 100, 50, 37 if rng.random() < 0.01 else 150)
                group = None if rng.random() < silent else (life["group"], 3 if rng.random() < 0.004 else 1)
                rows.append(person(track, box, actions, group))
                labels = [(other, {"conversation": 3 if rng.random() < hard else 1}) for other in sorted(life["talks"])]
                lists.append(member(track, box, interactions=None if rng.random() < silent else labels))
    if rng.random() < 0.2:
        frames = sorted(layers["2d"])
        layers["images"] = sorted(rng.sample(frames, max(1, len(frames) - 2 * 15 // step)))
    return {NAME: layers}


def test_people_who_are_met_between_keyframes_are_counted(tmp_path):
    """Labels at every frame: a person who is met for a moment only may make the number another one, or unknown."""
    store = memory_store(tmp_path, busy_world(random.Random(10)))
    with searched(store, NAME, RULES) as search:
        prover = make_prover(search)
        (form,) = (form for form in FORMS if form.counts)
        proven = [prover.prove(one) is not None for one in proposals(search, form)]
    assert prover.counts["count"] and any(proven)
