"""Ten thousand random tool calls: no accepted write names an observation that was not made, and no refusal writes."""

import json
from random import Random

import pytest
from reference_play import PAIR, form_of, line_of, play, turn

from jrdb_avr.agent.reference.loop import Limits

CALLS = 10_000
PER_GAME = 500
_VALUES = ("female", "male", "standing", "sitting", "cannot tell", "yes", "no", "red", "", 7, None)


def random_call(rng, text):
    """A call that is often sound, and otherwise wrong in one of its names."""
    names = [f"p{n}" for n in range(6)] + ["", "p 1", 3]
    seen = [f"o{n}" for n in range(1, 9)] + ["o0", "o99", "", None, 1]

    def box():
        left, top = rng.randrange(900), rng.randrange(900)
        return [left, top, left + rng.randrange(-20, 200), top + rng.randrange(-20, 200)]

    def fields():
        given = form_of(text)
        for key in rng.sample(sorted(given), 2):
            given[key] = rng.choice(_VALUES)
        return given

    name, other, observation = rng.choice(names), rng.choice(names), rng.choice(seen)
    match rng.randrange(6):
        case 0:
            return {"tool": "observe", "frame_id": f"{rng.randrange(300):06d}", "angle_deg": rng.uniform(0, 360)}
        case 1:
            persons = [{"id": rng.choice(names), "box": box(), **fields()} for _ in range(rng.randrange(4))]
            return {"tool": "add_people", "observation": observation, "people": persons}
        case 2:
            return {"tool": "add_entity", "observation": observation, "id": name, "box": box()}
        case 3:
            key = rng.choice(["gender", "age", "pose", "shirt"])
            value = rng.choice(_VALUES)
            return {"tool": "add_attribute", "observation": observation, "entity": name, "name": key, "value": value}
        case 4:
            key = rng.choice(["relation conversation", "relation hugging"])
            return {"tool": "add_relation", "observation": observation, "source": name, "name": key, "target": other}
        case _:
            return {"tool": "get_graph"}


def observations_of(write):
    arguments = json.loads(write.arguments)
    assert isinstance(arguments, dict), "a refused call keeps its arguments"
    return arguments.get("observation")


@pytest.mark.slow
def test_random_calls_never_write_what_was_not_observed(world):
    rng = Random(39)
    made = accepted = refused = 0
    while made < CALLS:
        turns = PER_GAME // 10
        worlds = []

        def reply(text, worlds=worlds):
            worlds.append(line_of(text, "World"))
            return turn(*[random_call(rng, text) for _ in range(10)])

        game = play([PAIR, *[reply] * turns], world=world, limits=Limits(turns=turns, refusals=turns))
        made += 10 * turns
        looks = 0
        for write in game.writes:
            if write.tool == "observe" and write.accepted:
                looks += 1
            if write.tool.startswith("add_"):
                accepted += write.accepted
                refused += not write.accepted
                if write.accepted:
                    assert observations_of(write) in {f"o{number}" for number in range(1, looks + 1)}
                else:
                    assert (write.fact, bool(write.reason)) == ("", True)
    assert accepted > CALLS / 20 and refused > CALLS / 20
