"""Nobody whom a question needs is hidden: by the polygons of the raw labels, and by no function of the program."""

import json
import random
from fractions import Fraction

import pytest
from environment import copy_real, needs_real
from keyframe_layers import layers_in_memory
from loaded_stores import without_graph
from oracle_covering import hidden_share
from random_worlds import in_crowds, sociable_world, with_chorus
from worlds import write_root

from jrdb_avr.engine.generate.run import generate
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules, Rules

HIDDEN = ("Severely_occluded", "Fully_occluded")


def needed_people(folder, visibility):
    """For each profile: the raw record of every box that its questions need, and those of the others in the frame."""
    store, rules = Store(folder / "store"), LoadRules(visibility=visibility)
    with without_graph(), layers_in_memory():
        load(find_root(folder / "root"), store, rules, 1)
        for profile in ("all", "paper", "train"):
            generate(store, Rules(load=rules), profile=profile, workers=1)
            yield profile, [*needed_records(store, folder / "root")]


def needed_records(store, root):
    sequence_of = {row["question_id"]: row["sequence"] for row in store.questions("questions").to_pylist()}
    labels = {}
    for row in store.questions("answers").to_pylist():
        sequence = sequence_of[row["question_id"]]
        if sequence not in labels:
            path = root / "labels" / "labels_2d_stitched" / f"{sequence}.json"
            labels[sequence] = json.loads(path.read_text("utf-8"))["labels"]
        for box in json.loads(row["needed"]):
            people = {record["label_id"]: record for record in labels[sequence][f"{box['frame']:06d}.jpg"]}
            yield people.pop(f"pedestrian:{box['track']}"), [*people.values()]


def half_covered(needed):
    shares = [hidden_share(own["box"], [other["box"] for other in others]) for own, others in needed]
    return [share for share in shares if share >= Fraction(1, 2)]


def write_crowds(folder, attributes):
    """Worlds in which people stand before each other; with degrees of occlusion, or without any."""
    rng, worlds = random.Random(11), {}
    for number in range(3):
        worlds |= in_crowds(with_chorus(sociable_world))(rng, f"yard-2020-01-0{number + 1}_0")
    for layers in worlds.values():
        for record in (record for some in layers["2d"].values() for record in some):
            x, y, *size = record["box"]
            record["box"] = [1500 + x / 6, y + 7 * int(record["label_id"].split(":")[1]) % 60, *size]
            if not attributes:
                del record["attributes"]
    write_root(folder / "root", worlds)


# With the rule off some are hidden, so that the test shows the difference.
@pytest.mark.parametrize(("visibility", "hidden"), [("clear", False), ("any", True)])
@pytest.mark.parametrize(
    "real", [0, pytest.param(3, marks=needs_real), pytest.param(9, marks=(needs_real, pytest.mark.slow))]
)
def test_no_needed_person_is_half_covered(tmp_path, real, visibility, hidden):
    if real:
        copy_real(tmp_path, 3, 3 + real)
    else:
        write_crowds(tmp_path, attributes=False)
    for profile, needed in needed_people(tmp_path, visibility):
        assert len(needed) > 20
        assert bool(half_covered(needed)) == hidden, profile


def test_no_needed_person_is_occluded_by_the_attributes(tmp_path):
    write_crowds(tmp_path, attributes=True)
    for profile, needed in needed_people(tmp_path, "clear"):
        assert len(needed) > 30
        assert not [own for own, _ in needed if own["attributes"]["occlusion"] in HIDDEN], profile
        # Others in the same frames are, and boxes do not decide.
        assert [one for _, others in needed for one in others if one["attributes"]["occlusion"] in HIDDEN]
        assert half_covered(needed)
