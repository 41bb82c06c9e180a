"""Files that cannot be taken at all are refused with one clear problem, and the rest loads.

Either they say more than any sequence has (the limits bound memory; they are lowered here, so that small files pass
them), or what stands in their place is no file that can be reached.
"""

from __future__ import annotations

import pytest
from loaded_stores import NAME, load_root, read_store
from worlds import load_reported, member, person, person_3d, write_root

from jrdb_avr.loaders.intervals import neighbors
from jrdb_avr.loaders.labelfiles import columns, facts, frames

BOX = (100, 60, 50, 200)


def found_in(folder, social):
    """What is read of one person in two 2D frames, beside a social layer."""
    return read_store(folder, {"2d": {f: [person(1, BOX)] for f in (0, 1)}, "social": social})[1]


def different(n):
    """Demographics of which no two are written alike."""
    return {0: [member(t, BOX, {"gender": {"Male": "1"}, "note": t}) for t in range(n)]}


def talking(n):
    return {0: [member(0, BOX, interactions=[(t, {"conversation": "1"}) for t in range(1, n + 1)])]}


def test_a_sequence_with_too_many_people_at_a_time_is_refused_and_the_rest_loads(monkeypatch, tmp_path):
    """Whoever is within five metres of everybody is beside everybody: facts grow with the square."""
    monkeypatch.setattr(neighbors, "MAX_BESIDE", 400)
    crowd, few = (
        {
            "2d": {f: [person(t, (40 * t, 60, 30, 100)) for t in range(people)] for f in (0, 15)},
            "3d": {f: [person_3d(t, 0.1 * t, 1.0) for t in range(people)] for f in (0, 15)},
        }
        for people in (20, 6)
    )
    store, reports = load_reported(tmp_path, {"crowd-1": crowd, "few-1": few})
    assert sorted(store.manifest().sequences) == ["few-1"]
    assert [(p.kind, p.file) for report in reports for p in report.problems] == [("sequence", "crowd-1")]
    (problem,) = reports[0].problems
    assert problem.reason == "more than 400 facts of who is beside whom: too many people at a time"
    assert store.interval("beside", "few-1").num_rows


def many_labels(n):
    return {0: [member(0, BOX, interactions=[(1, {f"label {i}": "1" for i in range(n)})])]}


@pytest.mark.parametrize(
    ("module", "name", "social", "reason"),
    [
        (columns, "MAX_DISTINCT", different, "more than 20 different values of one field"),
        (frames, "MAX_GATHERED", different, "more than 20 records"),
        (facts, "MAX_FACTS", talking, "more than 20 labels of one kind"),
        (facts, "MAX_FACTS", many_labels, "more than 20 labels of one kind"),
    ],
)
def test_a_file_that_says_too_much_is_refused_and_the_rest_loads(monkeypatch, tmp_path, module, name, social, reason):
    monkeypatch.setattr(module, name, 20)
    full = found_in(tmp_path / "full", social(20))
    assert full.problems == [] and "2d" in full.frames
    found = found_in(tmp_path / "more", social(21))
    (problem,) = found.problems
    assert (problem.kind, problem.layer, problem.count) == ("file", "social", 1)
    assert reason in problem.reason
    assert set(found.frames) == {"2d", "actions", "groups", "images"} and found.tables["boxes_2d"].num_rows == 2


@pytest.mark.parametrize("target", ["itself", "nothing"])
@pytest.mark.parametrize("layer", ["calibration", "timestamps"])
def test_a_link_that_leads_nowhere_costs_its_layer_alone(tmp_path, layer, target):
    root = write_root(tmp_path / "root", {NAME: {"2d": {0: [person(1, BOX)]}}})
    place = root / layer / ("cameras.yaml" if layer == "calibration" else NAME)
    place.parent.mkdir()
    place.symlink_to(place.name if target == "itself" else "gone")
    _, report = load_root(tmp_path, root)
    (problem,) = report.problems
    assert (problem.kind, problem.layer, problem.count) == ("file", layer, 1)
    assert report.layers == ["2d"] and report.boxes == 1
