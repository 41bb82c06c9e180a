"""Shifted frame numbers: planted ones are found and refused, and nothing else ever is.

The worlds are made here from scratch: people on the ground, seen by a turning robot, with noise and with an offset of
their own per person. Shifts are planted by naming frames otherwise.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from environment import REAL, examples
from loaded_stores import NAME, read_store
from worlds import member, person, person_3d

from jrdb_avr.loaders.layers.frame_offset import Tracks, check_shift
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.sequence import annotate

SHIFTS = (1, -1, 2, -2)


def places(rng, people, frames, walking=0.6, turning=0.02):
    """{track: {frame: (x, y)}} in metres in the robot's frame, three frames longer at both ends."""
    numbers = np.arange(-3, frames + 3)
    yaw = turning * np.cumsum(np.convolve(rng.normal(0, 1, len(numbers) + 60), np.ones(60) / 60, "same")[30:-30])
    world = {}
    for track in range(people):
        place = complex(*rng.uniform(-8, 8, 2))
        path = np.full(len(numbers), place)
        if rng.random() < walking:
            way = rng.uniform(0, 2 * math.pi) + np.cumsum(rng.normal(0, 0.03, len(numbers)))
            path = place + np.cumsum(rng.uniform(0.5, 1.6) / 15 * np.exp(1j * way))
        path = path * np.exp(1j * yaw)
        world[track] = {int(f): (z.real, z.imag) for f, z in zip(numbers, path, strict=True)}
    return world


def column(place):
    """Of a place (x, y), or of each row of such."""
    x, y = np.asarray(place).T
    return 3760 * (0.5 - np.arctan2(y, x) / (2 * math.pi)) % 3760


def seen(rng, world, frames, shift=0, step=1, phase=0, noise=1.0, bias=0.0, boxes=False):
    """What a layer holds of a world whose frame f it calls f - shift."""
    rows = []
    for track, path in world.items():
        off = rng.normal(0, bias) if bias else 0.0
        there = np.arange(phase, frames, step)
        there = there[rng.random(len(there)) < 0.9]
        middle = column(np.array([path[f + shift] for f in there.tolist()]).reshape(-1, 2))
        rows.append((np.full(len(there), track), there, (middle + off + rng.normal(0, noise, len(there))) % 3760))
    track, frame, centre = (np.concatenate(values) for values in zip(*rows, strict=True))
    sizes = [np.full(len(centre), size) for size in (60.0, 60.0, 200.0)]
    return Tracks(frame, track, centre, np.stack([centre - 30, *sizes], 1) if boxes else None)


@pytest.mark.parametrize("steps", [(1, 1), (1, 15), (15, 1), (15, 15)], ids=str)
def test_unshifted_layers_are_never_refused(steps):
    for seed in range(examples(10)):
        rng = np.random.default_rng(seed)
        frames = int(rng.choice([40, 150, 450]))
        world = places(rng, int(rng.integers(1, 15)), frames, rng.choice([0, 0.3, 1]), rng.choice([0, 0.03]))
        reference = seen(rng, world, frames, step=steps[0], noise=rng.choice([0, 2]))
        layer = seen(rng, world, frames, step=steps[1], noise=rng.choice([0, 5]), bias=rng.choice([0, 20]))
        assert check_shift("3d", layer, reference).result != "shifted", seed


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("seed", range(3))
def test_a_planted_shift_is_found_in_noise_and_bias(seed, shift):
    rng = np.random.default_rng(seed)
    world = places(rng, 20, 600)
    reference = seen(rng, world, 600, noise=0.5)
    check = check_shift("3d", seen(rng, world, 600, shift, noise=2, bias=15), reference)
    assert check.result == "shifted"
    assert f"only when moved by about {shift:+d} frames" in check.reason
    assert check.frames == pytest.approx(shift, abs=0.5)
    assert check_shift("3d", seen(rng, world, 600, 0, noise=2, bias=15), reference).result == "agrees"


@pytest.mark.parametrize("shift", SHIFTS)
def test_repeated_boxes_are_found_at_keyframes_that_never_meet(shift):
    rng = np.random.default_rng(5)
    world = places(rng, 12, 460)
    reference = seen(rng, world, 460, step=15, phase=3, noise=0, boxes=True)
    # The same keyframes under other numbers: no frame is in both layers.
    moved = Tracks(reference.frame - shift, reference.track, reference.column, reference.box)
    check = check_shift("social", moved, reference)
    assert check.result == "shifted" and f"by {shift:+d} frames" in check.reason
    assert check_shift("social", reference, reference).result == "agrees"


def test_standing_people_and_few_boxes_tell_nothing():
    rng = np.random.default_rng(1)
    world = places(rng, 20, 300, walking=0, turning=0)
    standing = seen(rng, world, 300, noise=0.3, boxes=True)
    assert check_shift("3d", seen(rng, world, 300, 2, noise=3, bias=20), standing).result == "not tested"
    few = places(rng, 2, 12)
    check = check_shift("3d", seen(rng, few, 12, 2), seen(rng, few, 12))
    assert (check.result, check.frames) == ("not tested", None)
    nobody = Tracks(standing.frame, standing.track + 1000, standing.column, standing.box)
    assert check_shift("3d", nobody, standing).reason == "no person is in both layers"


@pytest.mark.parametrize("shift", [0, *SHIFTS])
@pytest.mark.parametrize("repeats", [True, False], ids=["errors repeated", "errors of its own"])
def test_boxes_that_only_tremble_are_never_said_to_agree(shift, repeats):
    for seed in range(examples(1)):
        rng = np.random.default_rng(seed)
        standing = places(rng, 20, 600, walking=0, turning=0)
        reference = seen(rng, standing, 600, noise=2)
        layer = seen(rng, standing, 600, noise=3)
        if repeats:
            columns = reference.column + rng.normal(0, 3, len(reference.column))
            layer = Tracks(reference.frame - shift, reference.track, columns, None)
        assert check_shift("3d", layer, reference).result == "not tested", seed


def test_people_at_the_seam_do_not_count_as_moving_round():
    rng = np.random.default_rng(2)
    frames = np.arange(300)
    rows = [(t, f, (20 * math.sin(f / 9 + t) + 40 * t) % 3760) for t in range(-6, 6) for f in frames]
    track, frame, centre = (np.array(values) for values in zip(*rows, strict=True))
    reference = Tracks(frame, track + 6, centre, None)
    noisy = Tracks(frame, track + 6, (centre + rng.normal(0, 1, len(centre))) % 3760, None)
    assert check_shift("3d", noisy, reference).result == "agrees"


# -- files ---------------------------------------------------------------------------------------------------------


def world_files(shift_3d=0, shift_social=0, seed=0):
    rng = np.random.default_rng(seed)
    world = places(rng, 12, 300)
    layers = {"2d": {}, "3d": {}, "social": {}}
    for f in range(300):
        boxes = {t: (column(path[f]) - 20, 60, 40, 200) for t, path in world.items()}
        layers["2d"][f] = [person(t, box) for t, box in boxes.items()]
        layers["3d"][f] = [person_3d(t, *path[f + shift_3d]) for t, path in world.items()]
        layers["social"][f] = [
            member(t, (column(path[f + shift_social]) - 20, 60, 40, 200), {"gender": {"Male": "1"}})
            for t, path in world.items()
        ]
    return layers


def test_case_2_a_layer_with_another_numbering_is_refused_and_the_rest_loads(tmp_path):
    store, found = read_store(tmp_path / "bad", world_files(shift_3d=2))
    (problem,) = found.problems
    assert (problem.kind, problem.layer, problem.count) == ("file", "3d", 1)
    assert "only when moved by about +2 frames" in problem.reason
    assert store.annotation("boxes_3d", NAME).num_rows == 0
    assert "3d" not in found.frames and "demographics" in found.frames
    whole, clean = read_store(tmp_path / "good", world_files())
    assert clean.problems == [] and {check.layer: check.result for check in clean.shifts} == {
        "3d": "agrees",
        "social": "agrees",
    }
    for layer in ("boxes_2d", "demographics"):
        assert store.annotation(layer, NAME).equals(whole.annotation(layer, NAME))
    assert whole.annotation("boxes_3d", NAME).num_rows == 3600


def test_a_shifted_social_file_leaves_its_facts_to_the_reasoning_file(tmp_path):
    files = world_files(shift_social=-2)
    files["reasoning"] = world_files()["social"]
    store, found = read_store(tmp_path, files)
    assert [(p.layer, p.kind) for p in found.problems] == [("social", "file")]
    assert "only when moved by -2 frames" in found.problems[0].reason
    assert store.annotation("demographics", NAME).num_rows == 3600


@pytest.mark.skipif(not REAL.is_dir(), reason="the slice of real annotations is not here")
@pytest.mark.parametrize("shift", [0, *SHIFTS])
def test_real_boxes_under_other_numbers_are_found(tmp_path, shift):
    import json

    name = "packard-poster-session-2019-03-20_2"
    source = (REAL / "labels" / "labels_2d_stitched" / f"{name}.json").read_text()
    labels = json.loads(source)["labels"]
    moved = {f"{int(key[:6]) - shift:06d}.jpg": rows for key, rows in labels.items()}
    for folder, content in (("labels_2d_stitched", labels), ("labels_2d_activity_social_stitched", moved)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{name}.json").write_text(json.dumps({"labels": content}))
    (files,) = find_root(tmp_path).sequences
    (check,) = annotate(files).shifts
    assert check.result == ("shifted" if shift else "agrees")
    assert not shift or f"by {shift:+d} frames" in check.reason
