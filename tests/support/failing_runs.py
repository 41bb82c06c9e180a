"""A stored run in which each kind of evidence failure happens once."""

import json

import msgspec
from known_runs import BOX, ELSEWHERE, Benchmark, table

from jrdb_avr.queries.runs import questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.tables import INTERVALS, RUNS

CASES = {
    # name: (choice, box, frame), the look (frame, left or None for a panorama), cause
    "scores": ((1, BOX, 7), (7, 0), ""),
    "no box": ((1, None, 0), (7, 0), "no box"),
    "looked behind": ((1, ELSEWHERE, 7), (7, 2000), "never looked there"),
    "looked too early": ((1, ELSEWHERE, 7), (6, 0), "never looked there"),
    "a third of it": ((1, ELSEWHERE, 7), (7, 134), "never looked there"),
    "half of it": ((1, ELSEWHERE, 7), (7, 125), "nobody"),
    "over the seam": ((1, ELSEWHERE, 7), (7, 3500), "nobody"),
    "a panorama": ((1, ELSEWHERE, 7), (8, None), "nobody"),
    "another frame": ((1, BOX, 9), (7, 0), "frame where the target is absent"),
    "loose": ((1, (100.0, 100.0, 50.0, 59.0), 7), (7, 0), "right person, loose box"),
    "another person": ((1, (300.0, 100.0, 50.0, 120.0), 7), (7, 0), "wrong person"),
    "between two": ((1, (100.0, 100.0, 250.0, 120.0), 8), (7, 0), "right person, loose box"),
    "nobody": ((1, ELSEWHERE, 7), (7, 0), "nobody"),
}


def stored_failures(path, settings=None, families=("long_range",)):
    """A store in which run r fails in each way once; the questions are of these families in turn."""
    benchmark = Benchmark([(name, "s", families[place % len(families)]) for place, name in enumerate(CASES)])
    run = benchmark.run([given for given, _, _ in CASES.values()])
    store = Store(path)
    benchmark.write(store)
    people = [(7, 1, BOX), (8, 1, BOX), (7, 2, (300.0, 100.0, 50.0, 120.0)), (8, 2, (320.0, 100.0, 30.0, 120.0))]
    sightings = [
        {"sequence": "s", "frame": frame, "track": track, **dict(zip("xywh", box, strict=True))}
        for frame, track, box in people
    ]
    store.write_interval("sightings", "s", table(sightings, INTERVALS["sightings"]))
    steps = []
    for name, (_, (frame, left), _) in CASES.items():
        asked = {"sequence": "s", "frame_index": frame} | ({} if left is None else {"angle_deg": 1.0})
        looked = {"run_id": "r", "question_id": name, "kind": "observe", "request": json.dumps(asked)}
        shown = {"frame_id": f"{frame:06}"} | ({} if left is None else {"angle_deg": 1.0, "left": left})
        steps.append(looked | {"response": json.dumps(shown)})
        # A refused look shows nothing, and other steps are no looks.
        steps.append(looked | {"request": '{"frame_index":7,"angle_deg":0}', "response": '{"refused":"twice"}'})
        steps.append(looked | {"kind": "model", "request": "[]", "response": "{}"})
    store.write_run("r", "steps", table(steps, RUNS["steps"]))
    store.write_run("r", "predictions", benchmark.written["predictions"])
    write_run_manifest(
        store, msgspec.structs.replace(run.manifest, questions_sha256=questions_hash(store), settings=settings or {})
    )
    return benchmark, run, store
