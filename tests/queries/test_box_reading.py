"""How a run's boxes were written, and what would be right if their axes were swapped: named queries against Python."""

import json
import random
from collections import Counter

import pytest
from scored_runs import table

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.tables import QUESTIONS, RUNS

RING = 3760


def overlap(a, b):
    """IoU of two boxes on the ring, b moved by whole turns to where it meets a best."""
    rows = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    columns = max(
        min(a[0] + a[2], b[0] + t + b[2]) - max(a[0], b[0] + t) for t in (-2 * RING, -RING, 0, RING, 2 * RING)
    )
    both = max(rows, 0) * max(columns, 0)
    return both / (a[2] * a[3] + b[2] * b[3] - both)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Two runs of sixty questions: boxes as they are, with their axes swapped, or wrong; in crops and panoramas."""
    generator = random.Random(1)
    store = Store(tmp_path_factory.mktemp("boxes"))
    evidence, predictions, steps, expected = [], [], [], Counter()
    for i in range(60):
        gold = (generator.uniform(-50, RING), generator.uniform(0, 150), generator.uniform(30, 90), 200.0)
        evidence.append({"sequence": "s", "track": i, "frame": 7, **dict(zip("xywh", gold, strict=True))})
        for run_id in ("a", "b"):
            width = generator.choice([480, RING])
            left = 0 if width == RING else (gold[0] - generator.uniform(0, 380)) % RING // 1
            seen = ((gold[0] - left) % RING, *gold[1:])
            seen = [value + generator.uniform(-20, 20) for value in seen[:2]] + list(seen[2:])
            if generator.random() < 0.5:
                x, y, w, h = seen
                seen = [y / 480 * width, x / width * 480, h / 480 * width, w / width * 480]
            frame = generator.choice([7, 7, 7, 8])
            stitched = [(left + seen[0]) % RING, *seen[1:]]
            predictions.append(
                {"run_id": run_id, "question_id": f"q{i}", "status": "answered", "evidence_frame": frame}
                | {f"evidence_{key}": value for key, value in zip("xywh", stitched, strict=True)}
            )
            told = {"image_box": seen, "stitched_box": stitched, "box_key": generator.choice(["bbox", "box_2d"])}
            earlier = {"image_box": [1, 2, 3, 4], "stitched_box": [5, 6, 7, 8], "box_key": "bbox"}
            request = json.dumps({"frames": [frame], "width": width, "height": 480, "left": left})
            for step, (kind, response) in enumerate(
                [("model", "{"), ("solve", json.dumps(earlier)), ("solve", json.dumps(told)), ("solve", "no JSON")]
            ):
                steps.append(
                    {"run_id": run_id, "question_id": f"q{i}", "step": step, "kind": kind}
                    | {"request": request if kind == "solve" and step < 3 else "no JSON", "response": response}
                )
            expected[run_id, "keys", "bbox"] += 1
            expected[run_id, "keys", told["box_key"]] += 1
            x, y, w, h = seen
            swapped = (left + y / 480 * width, x / width * 480, h / 480 * width, w / width * 480)
            expected[run_id, "boxes"] += 1
            expected[run_id, "read"] += frame == 7 and overlap(stitched, gold) >= 0.5
            expected[run_id, "swapped"] += frame == 7 and overlap(swapped, gold) >= 0.5
    asked = [{"question_id": f"q{i}", "sequence": "s", "target_track": i} for i in range(60)]
    for name, rows in (("questions", asked), ("answers", asked), ("evidence", evidence)):
        known = [{key: value for key, value in row.items() if key in QUESTIONS[name].names} for row in rows]
        store.write_questions(name, table(known, QUESTIONS[name]), {})
    for run_id in ("a", "b"):
        for name, rows in (("predictions", predictions), ("steps", steps)):
            own = [row for row in rows if row["run_id"] == run_id]
            store.write_run(run_id, name, table(own, RUNS[name]))
    return store, expected


def test_boxes_if_their_axes_were_swapped(world):
    store, expected = world
    found = store.sql("axes_swapped").to_pylist()
    assert found == [
        {
            "run_id": run_id,
            "boxes": 60,
            "right_as_read": expected[run_id, "read"],
            "right_if_swapped": expected[run_id, "swapped"],
        }
        for run_id in ("a", "b")
    ]
    assert all(10 < row["right_as_read"] < 50 and 10 < row["right_if_swapped"] < 50 for row in found)


def test_keys_that_boxes_were_written_under(world):
    store, expected = world
    found = {(row["run_id"], row["box_key"]): row["times"] for row in store.sql("box_keys").to_pylist()}
    assert found == {
        (run_id, key): n for (run_id, *kind), n in expected.items() if kind[0] == "keys" for key in kind[1:]
    }
