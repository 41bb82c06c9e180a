"""A public store holds what a method may see, and is enough for its run."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from environment import ROOT
from painted import SEQUENCE
from processes import run

from jrdb_avr.agent.simulated.knobs import PROFILES
from jrdb_avr.agent.simulated.server import marker_server
from jrdb_avr.engine.run.opaque import opaque_names
from jrdb_avr.engine.run.public import export_public, strip_metadata
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

COLUMNS = {
    "questions.parquet": ["question_id", "sequence", "question", "choices", "answer_mode"],
    "sequences.parquet": ["sequence", "fps", "frame_count", "frames"],
}


@pytest.fixture
def full(small_demo, tmp_path):
    """The store of the demo, with answers, labels and a graph; its panoramas stay with the demo."""
    shutil.copytree(small_demo.folder / "store", tmp_path / "store")
    manifest = tmp_path / "store" / "store.json"
    found = json.loads(manifest.read_text())
    images = (small_demo.folder / "store" / found["image_root"]).resolve()
    manifest.write_text(json.dumps(found | {"image_root": str(images)}))
    return Store(tmp_path / "store")


@pytest.mark.parametrize("opaque", [False, True])
def test_a_public_store_holds_nothing_private(full, tmp_path, opaque):
    made = tmp_path / "public"
    assert run("export", "--store", full.path, "--public", made, *(["--opaque"] if opaque else []))[0] == 0
    files = [path for path in made.rglob("*") if path.is_file()]
    tables = [path for path in files if path.suffix == ".parquet"]
    assert {path.name: pq.read_schema(path).names for path in tables} == COLUMNS and len(tables) == 2
    assert {key for path in tables for key in pq.read_schema(path).metadata} <= {b"canary", b"generation"}
    pictures = [path for path in files if path.suffix == ".jpg"]
    assert {path.suffix for path in files} == {".parquet", ".json", ".jpg"}
    assert json.loads((made / "store.json").read_text())["sequences"] == {}
    real = full.questions("sequences")["sequence"].to_pylist()
    names = opaque_names(full, real) if opaque else {name: name for name in real}
    shown = pq.read_table(made / "questions" / "sequences.parquet").to_pylist()
    assert {row["sequence"] for row in shown} == set(names.values())
    assert {(path.parent.name, int(path.stem)) for path in pictures} == {
        (row["sequence"], frame) for row in shown for frame in row["frames"]
    }
    if opaque:
        for path in files:
            data = path.read_bytes()
            assert not any(name.encode() in data or name in str(path.relative_to(made)) for name in real), path
        assert all(strip_metadata(path.read_bytes(), path) == path.read_bytes() for path in pictures)


def test_metadata_leave_a_picture_and_pixels_stay(asked_world, tmp_path):
    source = next((asked_world / "images" / SEQUENCE).glob("*.jpg"))
    data = source.read_bytes()

    def segment(marker):
        return bytes([0xFF, marker]) + (2 + len(SEQUENCE)).to_bytes(2, "big") + SEQUENCE.encode()

    marked = data[:2] + segment(0xE1) + segment(0xFE) + segment(0xED) + data[2:] + SEQUENCE.encode()
    progressive = cv2.imencode(".jpg", cv2.imread(str(source)), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    for file, plain in ((marked, data), (progressive[:2] + segment(0xFE) + progressive[2:], progressive)):
        stripped = strip_metadata(file, source)
        assert SEQUENCE.encode() in file and SEQUENCE.encode() not in stripped
        one, other = (cv2.imdecode(np.frombuffer(own, np.uint8), cv2.IMREAD_COLOR) for own in (stripped, plain))
        assert np.array_equal(one, other)
    for broken in (b"", b"GIF89a", data[: len(data) // 2], data[:20]):
        with pytest.raises(StoreError, match="is not a"):
            strip_metadata(broken, source)


def test_what_a_public_store_lacks_is_refused_in_a_line(full, tmp_path):
    made = tmp_path / "public"
    export_public(full, made)
    base = ("evaluate", "--store", made, "--method", "react", "--model", "marker")
    for options in (["--family", "long_range"], ["--template", "gap"], ["--per-template", "1"]):
        code, _, err = run(*base, *options)
        assert code == 1 and "a public store have no" in err and err.count("\n") == 1
    code, _, err = run("evaluate", "--store", made, "--method", "agent", "--model", "marker")
    assert code == 1 and "--world-db" in err
    assert run("score", "--store", made)[0] == 1


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv")
@pytest.mark.parametrize("opaque", [False, True])
def test_another_user_evaluates_on_a_public_store(full, small_demo, opaque):
    program = [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()"]
    user = ["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups"]
    method = ("--method", "react", "--model", "simulated:noisy", "--limit", "8", "--no-scores")
    hidden = ["--opaque"] if opaque else []
    assert run("evaluate", "--store", full.path, "--run-id", "own", *method, *hidden)[0] == 0
    # The server is of this user: the other one needs nothing but its address.
    with tempfile.TemporaryDirectory() as folder, marker_server(None, PROFILES["noisy"]) as url:
        place = Path(folder)
        place.chmod(0o755)
        export_public(full, place / "public", opaque)
        ids = pq.read_table(full.run_path("own") / "predictions.parquet")["question_id"].to_pylist()
        (place / "public" / "runs").chmod(0o777)
        full.path.chmod(0o700)
        environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT.parent), "HOME": folder}

        def other(*arguments, command=program):
            return subprocess.run(
                [*user, *command, *map(str, arguments)], env=environment, cwd=folder, capture_output=True, text=True
            )

        if other(command=[*program[:2], "import jrdb_avr"]).returncode:
            pytest.skip("other users cannot read this package")
        assert other(full.path, command=["ls"]).returncode != 0
        chosen = [*method[:4], "--questions", ",".join(ids), "--no-scores"]
        done = other("evaluate", "--store", place / "public", "--run-id", "away", "--base-url", url, *chosen)
        assert done.returncode == 0, done.stderr
        lines = place / "away.jsonl"
        code, _, err = run("export", "away", "--store", place / "public", "--jsonl", lines)
        assert code == 0, err
        assert run("score", "--store", full.path, "--jsonl", lines)[0] == 0
        tables = [pq.read_table(full.run_path(name) / "predictions.parquet") for name in ("own", "away")]
        one, two = (own.drop_columns(["run_id", "seconds"]).sort_by("question_id").to_pylist() for own in tables)
        assert one == two
        assert run("score", "--store", full.path, "own")[0] == 0
        scores = [pq.read_table(full.run_path(name) / "scores.parquet") for name in ("own", "away")]
        one, two = (own.drop_columns(["run_id"]).sort_by("question_id").to_pylist() for own in scores)
        assert one == two
