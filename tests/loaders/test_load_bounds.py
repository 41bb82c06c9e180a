"""Files that cannot be taken at all are refused with one clear problem, and the rest loads.

Either they say more than any sequence has (the limits bound memory; they are lowered here, so that small files pass
them), or what stands in their place is no file that can be reached.
"""

from __future__ import annotations

import shutil

import pytest
from loaded_stores import NAME, load_root, read_store
from oracle_candidates import FIRST, PLACES, TOGETHER
from worlds import load_reported, member, person, person_3d, write_root

from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.validate.checks import validate
from jrdb_avr.loaders.intervals import neighbors
from jrdb_avr.loaders.labelfiles import columns, facts, frames
from jrdb_avr.loaders.load import rebuild
from jrdb_avr.queries.compiler.reads import SceneReader
from jrdb_avr.queries.compiler.solve import PlanQuery, solve
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrWarning
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.rules import LoadRules, Rules

BOX = (100, 60, 50, 200)


def found_in(folder, social):
    """What is read of one person in two 2D frames, beside a social layer."""
    return read_store(folder, {"2d": {f: [person(1, BOX)] for f in (0, 1)}, "social": social})[1]


def different(n):
    """Demographics of which no two are written alike."""
    return {0: [member(t, BOX, {"gender": {"Male": "1"}, "note": t}) for t in range(n)]}


def talking(n):
    return {0: [member(0, BOX, interactions=[(t, {"conversation": "1"}) for t in range(1, n + 1)])]}


def test_a_view_with_too_many_facts_is_left_out_and_the_rest_of_the_sequence_loads(monkeypatch, tmp_path):
    """Whoever is within five metres of everybody is beside everybody: facts grow with the square."""
    monkeypatch.setattr(neighbors, "MAX_BESIDE", 400)
    crowd, few = (
        {
            "2d": {f: [person(t, (40 * t, 60, 30, 100)) for t in range(people)] for f in (0, 15)},
            "3d": {f: [person_3d(t, 0.1 * t, 1.0) for t in range(people)] for f in (0, 15)},
        }
        for people in (20, 6)
    )
    store, (report, other) = load_reported(tmp_path, {"crowd-1": crowd, "few-1": few})
    assert (report.problems, report.boxes, report.boxes_3d, other.warnings) == ([], 40, 40, [])
    assert [line[:65] for line in report.warnings] == [
        "more than 400 facts of the place of a person as another one sees "
    ]
    for name, listed in (("crowd-1", False), ("few-1", True)):
        flags = store.interval("sightings", name, ["robot_view_listed", "person_view_listed"]).to_pylist()
        assert {tuple(row.values()) for row in flags} == {(True, listed)}
        assert ({*store.interval("beside", name)["label"].to_pylist()} > {*FIRST}) == listed


def test_no_question_uses_facts_that_are_left_out(monkeypatch, small_demo, tmp_path):
    """They are unknown, in the plans that named them too; all other questions are generated and valid."""
    store = Store(shutil.copytree(small_demo.folder / "store", tmp_path / "store"))
    plans = plans_of(store, [*FIRST, *PLACES])
    assert plans_of(store, FIRST) and plans_of(store, PLACES)
    monkeypatch.setattr(neighbors, "MAX_BESIDE", 200)
    with pytest.warns(AvrWarning, match="more than 200 facts of the (first person|place of a person)") as warned:
        rebuild(store, LoadRules(), 1)
    assert len(warned) == 2
    with Graph.open(store.graph_path) as graph:
        solved = solve(SceneReader(graph, LoadRules()), plans, Rules())
    assert {solution.outcome for solution in solved} == {"unknown"}
    generate(store, workers=1)
    assert plans_of(store, TOGETHER) and not plans_of(store, [*FIRST, *PLACES])
    report = validate(store, replay_proofs=True)
    assert report.faults == {} and report.checked["replay"]


def plans_of(store, labels):
    """The plans of a store's questions that name one of the labels."""
    rows = store.questions("answers")["plan"].to_pylist()
    (sequence,) = store.manifest().sequences
    return [PlanQuery(parse_plan(row), sequence) for row in rows if any(label in row for label in labels)]


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
