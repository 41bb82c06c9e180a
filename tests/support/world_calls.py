"""Calls of an agent's tools for tests: good ones, good ones spoiled, and junk."""

import math

from world_play import BOX, look, whole

from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP

VICTIM = "run/" + f"{999:016x}"
"""Key of an episode that no other may touch."""
INJECTED = (
    "'}) DETACH DELETE n //",
    "`",
    "\\",
    "$id",
    "p1'",
    "{id}",
    "secret/1",
    VICTIM,
    f"{VICTIM}/p1",
    f"{VICTIM}/o1",
)
ODD = ("", " ", "\x00", "\ud800", "\u202e", "p" * 33, "x" * 5000, "о1", "nan", "o01", "o0", "o-1", "1")
JUNK = (
    *(None, True, 0, -1, 10**400, 2**63, -(2**70), 0.5, math.nan, math.inf, -math.inf, 1e308),
    *([], [[]], {}, {"a": {"b": [None, "\ud800"]}}, [1, 2, 3, 4], {1: 2}, (1,), b"x", {"x"}),
    *INJECTED,
    *ODD,
)
RELATIONS = ("conversation", "Walking_Together", SAME_GROUP, FIRST_LEFT, "front left, close", "front, far", "stands by")
ATTRIBUTES = (
    ("gender", "female"),
    ("gender", "Male"),
    ("age", "young adulthood"),
    ("action", "walking"),
    ("action", "standing"),
    ("Action", "holding something"),
    ("group_size", 3),
    ("distance_m", 2.5),
    ("sector", "left"),
    ("object", "holding: bag"),
    ("interaction", "hugging"),
    ("coat", "red'); MATCH (n) DETACH DELETE n"),
    ("steps", 4),
    ("gender", "secret"),
    ("object", "bag"),
)
EDGES = (-1.0, 0.0, 5.0, 480.0, 3760.0, 1e300, math.nan, math.inf, -math.inf)
SCAFFOLD = [
    ("observed", 15, 180.0),
    ("observed", 30, 0.0),
    ("observed", 15, 350.0),
    *(("add_entity", {"id": p, "kind": "person", "observation": "o1", "box": []}, BOX) for p in ("p1", "p2")),
    ("add_entity", {"id": "p3", "kind": "person", "observation": "o2", "box": []}, BOX),
]
"""Observations and people that calls may name, so that many of them are grounded."""


def calls_of(rng, most=30):
    """Calls: good ones, good ones with one part replaced, added or left out, and junk."""
    return [*SCAFFOLD, *(_call(rng) for _ in range(most))]


def _call(rng):
    observation = rng.choice(("o1", "o1", "o2", "o2", "o3", "o3", "o4", f"{VICTIM}/o1"))
    one, two = rng.sample(("p1", "p2", "p3"), 2)
    name, value = rng.choice(ATTRIBUTES)
    match rng.randrange(12):
        case 0:
            return "observed", rng.choice((0, 15, 30)), rng.choice((0.0, 180.0, 350.0, None))
        case 1:
            return "noted", rng.choice(JUNK), rng.random() < 0.5, _text(rng)
        case 2:
            return "refused", rng.choice(JUNK), _text(rng)
        case 3 | 4 | 5:
            good = {"id": one, "kind": "person", "observation": observation, "box": [1, 2, 3, 4]}
            if rng.random() < 0.5:
                good["node"] = rng.choice(("a", "b", None, "c"))
            odd = (Box(*rng.choices(EDGES, k=4)), "the box is unreadable", Box(470.0, 0.0, 10.0, 480.0000000001))
            return "add_entity", _wild(rng, good), BOX if rng.random() < 0.7 else rng.choice(odd)
        case 6 | 7 | 8:
            good = {"entity": one, "name": name, "value": value, "observation": observation}
            return "add_attribute", _wild(rng, good)
        case _:
            good = {"source": one, "name": rng.choice(RELATIONS), "target": two, "observation": observation}
            return "add_relation", _wild(rng, good)


def _wild(rng, good):
    junk = rng.choice((_text(rng), *JUNK))
    match rng.randrange(10):
        case 0:
            return junk
        case 1 | 2:
            return good | {rng.choice(sorted(good.keys() - {"box"})): junk}
        case 3:
            return good | {_text(rng): junk}
        case 4:
            return {key: value for key, value in good.items() if key != rng.choice(sorted(good))}
    return good


def _text(rng):
    return "".join(chr(rng.choice((rng.randrange(128), rng.randrange(0x110000)))) for _ in range(rng.randrange(12)))


def play(episode, calls):
    """Make the calls, each in a step of its own; what was said to each write."""
    said = []
    for step, (tool, *values) in enumerate(calls, 1):
        match tool:
            case "observed":
                frame, angle = values
                episode.observed(whole(frame) if angle is None else look(frame, angle), step)
            case "noted":
                episode.noted("get_graph", values[0], step, *values[1:])
            case "refused":
                said.append(episode.refused("final_answer", *values, step))
            case _:
                said.append(episode.add(tool, values[0], step, *values[1:]))
    return said
