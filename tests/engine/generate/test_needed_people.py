"""Nobody whom a question needs is hidden: by the polygons of the raw labels, and by no function of the program."""

import json
import shutil
from fractions import Fraction

import pytest
from environment import REAL
from keyframe_layers import layers_in_memory
from loaded_stores import without_graph
from oracle_covering import hidden_share

from jrdb_avr.engine.generate.run import generate
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules, Rules


def needed_shares(store, root):
    """The covered share of every box that a question needs."""
    sequence_of = {row["question_id"]: row["sequence"] for row in store.questions("questions").to_pylist()}
    labels = {}
    for row in store.questions("answers").to_pylist():
        sequence = sequence_of[row["question_id"]]
        if sequence not in labels:
            path = root / "labels" / "labels_2d_stitched" / f"{sequence}.json"
            labels[sequence] = json.loads(path.read_text("utf-8"))["labels"]
        for box in json.loads(row["needed"]):
            people = {record["label_id"]: record["box"] for record in labels[sequence][f"{box['frame']:06d}.jpg"]}
            own = people.pop(f"pedestrian:{box['track']}")
            yield hidden_share(own, people.values())


@pytest.mark.skipif(not REAL.exists(), reason="the real annotations are not here")
@pytest.mark.parametrize("number", [3, pytest.param(9, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("visibility", "hidden"), [("clear", False), ("any", True)])
def test_no_needed_person_is_half_covered(tmp_path, number, visibility, hidden):
    folder = tmp_path / "root" / "labels" / "labels_2d_stitched"
    folder.mkdir(parents=True)
    every = sorted((REAL / "labels" / "labels_2d_stitched").glob("*.json"), key=lambda path: path.stat().st_size)
    for path in every[3 : 3 + number]:
        shutil.copy(path, folder)
    store, rules = Store(tmp_path / "store"), LoadRules(visibility=visibility)
    with without_graph(), layers_in_memory():
        load(find_root(tmp_path / "root"), store, rules, 1)
        for profile in ("all", "paper", "train"):
            generate(store, Rules(load=rules), profile=profile, workers=1)
            shares = [*needed_shares(store, tmp_path / "root")]
            assert len(shares) > 20
            # With the rule off some are hidden, so that the test shows the difference.
            assert any(share >= Fraction(1, 2) for share in shares) == hidden, profile
