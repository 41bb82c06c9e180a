"""The causes of boxes that do not score, against sets of pixels over made-up boxes, looks and people."""

import json
import random
from collections import Counter

import msgspec
import pytest
from scored_runs import Benchmark, table

from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.report.truth import Truth
from jrdb_avr.queries.runs import questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.tables import INTERVALS, RUNS

FRAMES = (6, 7, 8)
SEQUENCES = ("s0", "s1")


def columns(first, width):
    return {column % 3760 for column in range(first, first + width)}


def iou(a, b):
    both = len(columns(a[0], a[2]) & columns(b[0], b[2])) * len(
        set(range(a[1], a[1] + a[3])) & set(range(b[1], b[1] + b[3]))
    )
    return both / (a[2] * a[3] + b[2] * b[3] - both)


def cause(target, people, looks, frame, box):
    """Why a box does not score; target and people: boxes by frame; looks: (frame, left column or None)."""
    if box is None:
        return "no box"
    own = iou(target[frame], box) if frame in target else 0
    if own >= 0.5:
        return ""
    wide = [(at, columns(0, 3760) if left is None else columns(left, 480)) for at, left in looks]
    if not any(
        2 * len(shown & columns(target[at][0], target[at][2])) >= target[at][2] for at, shown in wide if at in target
    ):
        return "never looked there"
    if frame not in target:
        return "frame where the target is absent"
    most = max(iou(one, box) for one in people[frame])
    return "right person, loose box" if 0 < own == most else "wrong person" if most else "nobody"


@pytest.mark.slow
def test_causes_are_those_of_pixels(tmp_path):
    draw = random.Random(5)

    def some_box(near=None):
        if near is None:
            return draw.randrange(-40, 3720), draw.randrange(400), draw.randrange(20, 80), draw.randrange(20, 80)
        x, y, w, h = near
        return x + draw.randrange(-w // 2, w) + draw.choice((-3760, 0, 3760)), y, w + draw.randrange(40), h

    benchmark, store = Benchmark([(f"q{i:03}", SEQUENCES[i % 2], "long_range") for i in range(240)]), Store(tmp_path)
    targets = {name: {frame: some_box() for frame in FRAMES[1:]} for name in benchmark.ids}
    people = {s: {frame: [some_box() for _ in range(10)] for frame in FRAMES} for s in SEQUENCES}
    for number, boxes in enumerate(targets.values()):
        for frame, box in boxes.items():
            people[SEQUENCES[number % 2]][frame].append(box)
    rows = [
        {"sequence": SEQUENCES[number % 2], "track": number, "frame": frame, **dict(zip("xywh", box, strict=True))}
        for number, boxes in enumerate(targets.values())
        for frame, box in boxes.items()
    ]
    benchmark.tables["evidence"] = table(rows, benchmark.tables["evidence"].schema)
    answers = [row | {"target_track": n} for n, row in enumerate(benchmark.tables["answers"].to_pylist())]
    benchmark.tables["answers"] = table(answers, benchmark.tables["answers"].schema)
    benchmark.truth = Truth(*benchmark.tables.values())
    benchmark.write(store)
    for sequence, frames in people.items():
        rows = [
            {"sequence": sequence, "frame": frame, "track": track, **dict(zip("xywh", box, strict=True))}
            for frame, boxes in frames.items()
            for track, box in enumerate(boxes)
        ]
        store.write_interval("sightings", sequence, table(rows, INTERVALS["sightings"]))
    given, steps, expected = [], [], Counter()
    for number, name in enumerate(benchmark.ids):
        target, others, frame = targets[name], people[SEQUENCES[number % 2]], draw.choice(FRAMES)
        box = draw.choice(
            (None, some_box(), *[some_box(target[draw.choice(FRAMES[1:])])] * 3, some_box(others[frame][0]))
        )
        x, _, w, _ = target[7]
        left = draw.choice((None, (x + w // 2) % 3760, (x + w // 2 - 480) % 3760, (x - draw.randrange(480)) % 3760))
        looks = [(draw.choice(FRAMES), left) for _ in range(draw.randrange(3))]
        given.append((1, box, frame))
        for at, left in looks:
            shown = {"frame_id": f"{at:06}"} | ({} if left is None else {"angle_deg": 1.0, "left": left})
            row = {"run_id": "r", "question_id": name, "kind": "observe", "response": json.dumps(shown)}
            steps += [row, row | {"response": draw.choice(("", "{", "[]", '{"refused": "twice"}'))}]
        expected[cause(target, others, looks, frame, box)] += 1
    run = benchmark.run(given)
    store.write_run("r", "predictions", benchmark.written["predictions"])
    store.write_run("r", "steps", table(steps, RUNS["steps"]))
    write_run_manifest(store, msgspec.structs.replace(run.manifest, questions_sha256=questions_hash(store)))
    assert len(expected) == 7 and min(expected.values()) >= 5
    found = {row["cause"]: row["times"] for row in report(store).table("evidence_failures")}
    assert found == {name: times for name, times in expected.items() if name}
