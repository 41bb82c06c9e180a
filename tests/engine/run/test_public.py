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
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from environment import ROOT
from painted import SEQUENCE
from processes import run

from jrdb_avr.agent.simulated.profiles import PERFECT
from jrdb_avr.agent.simulated.server import simulated_server
from jrdb_avr.agent.simulated.sight import Sight
from jrdb_avr.engine.integrations.huggingface import export_folders
from jrdb_avr.engine.report.bundle import write_bundle
from jrdb_avr.engine.report.comparison import diff
from jrdb_avr.engine.report.leaderboard import leaderboard, score_bundles
from jrdb_avr.engine.run.public import export_public, strip_metadata
from jrdb_avr.engine.validate.references import read_references
from jrdb_avr.queries.opaque import opaque_ids, opaque_names
from jrdb_avr.queries.runs import run_ids
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


def refusal(*command):
    """The message of a command that fails. It is one line."""
    code, _, err = run(*command)
    assert code == 1 and err.count("\n") == 1
    return err


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
    stored = full.questions("questions")["question_id"].to_pylist()
    ids = pq.read_table(made / "questions" / "questions.parquet")["question_id"].to_pylist()
    assert ids == sorted(opaque_ids(full, stored).values()) and not set(ids) & set(stored)
    export_public(full, tmp_path / "again", opaque)
    assert [path.read_bytes() for path in files] == [
        (tmp_path / "again" / path.relative_to(made)).read_bytes() for path in files
    ]
    assert {(path.parent.name, int(path.stem)) for path in pictures} == {
        (row["sequence"], frame) for row in shown for frame in row["frames"]
    }
    originals = {path.stat().st_ino for path in Path(full.manifest().image_root).rglob("*.jpg")}
    assert originals and not originals & {path.stat().st_ino for path in pictures}
    assert all(strip_metadata(path.read_bytes(), path) == path.read_bytes() for path in pictures)
    if opaque:
        for path in files:
            data = path.read_bytes()
            assert not any(name.encode() in data or name in str(path.relative_to(made)) for name in real), path


def test_metadata_leave_a_picture_and_pixels_stay(asked_world, tmp_path):
    source = next((asked_world / "images" / SEQUENCE).glob("*.jpg"))
    data = source.read_bytes()

    def segment(marker, start=b""):
        body = start + SEQUENCE.encode()
        return bytes([0xFF, marker]) + (2 + len(body)).to_bytes(2, "big") + body

    texts = b"".join(map(segment, (*range(0xE0, 0xF0), 0xFE, 0xDC)))
    texts += segment(0xE0, b"JFIF\0\1\1\0\0\1\0\1\0\0") + segment(0xEE, b"Adobe\0d\0\0\0\0\1")
    progressive = cv2.imencode(".jpg", cv2.imread(str(source)), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    scan = data.index(b"\xff\xda")
    for file in (
        data[:2] + texts + data[2:] + SEQUENCE.encode(),
        progressive[:2] + segment(0xFE) + progressive[2:],
        data[:2] + b"\xff\xff" + texts + data[2:scan] + b"\xff\xff" + data[scan:-2] + b"\xff\xff" + data[-2:],
        # Without its Adobe segment, this picture would be decoded in other colours.
        data[:2] + segment(0xEE, b"Adobe\0d\0\0\0\0\0") + data[20:],
    ):
        stripped = strip_metadata(file, source)
        assert strip_metadata(stripped, source) == stripped
        assert SEQUENCE.encode() in file and SEQUENCE.encode() not in stripped
        one, other = (cv2.imdecode(np.frombuffer(own, np.uint8), cv2.IMREAD_COLOR) for own in (stripped, file))
        assert np.array_equal(one, other)
    for broken in (b"", b"GIF89a", data[: len(data) // 2], data[:20]):
        with pytest.raises(StoreError, match="is not a"):
            strip_metadata(broken, source)


def test_a_file_that_is_no_picture_is_not_copied(full, tmp_path):
    images = shutil.copytree(full.manifest().image_root, tmp_path / "pictures")
    manifest = json.loads((full.path / "store.json").read_text())
    (full.path / "store.json").write_text(json.dumps(manifest | {"image_root": str(images)}))
    picture = next(images.rglob("*.jpg"))
    picture.unlink()
    picture.symlink_to(full.path / "store.json")
    export = ("export", "--store", full.path, "--public")
    assert "is not a" in refusal(*export, tmp_path / "public") and not (tmp_path / "public").exists()
    picture.unlink()
    table = full.questions("sequences")
    renamed = table.set_column(0, table.schema.field(0), pa.array(["other"] * len(table)))
    pq.write_table(pa.concat_tables([table, renamed]), full.question_path("sequences"))
    code, _, err = run(*export, tmp_path / "public")
    assert code == 0 and f"{len(table)} of {2 * len(table)} sequences have no panorama" in err
    shutil.rmtree(images)
    assert "no panorama" in refusal(*export, tmp_path / "other") and not (tmp_path / "other").exists()


def test_a_public_store_has_no_guessers_below_its_runs(full, tmp_path):
    export_public(full, tmp_path / "public")
    public = Store(tmp_path / "public")
    assert len(read_references(full)) == 3 and read_references(public) == []
    shutil.copytree(full.path / "runs", public.path / "runs", dirs_exist_ok=True)
    for options in ([], ["--paper", "--as", "Qwen3.5 9B"], ["--html", tmp_path / "report.html"]):
        code, out, err = run("report", "--store", public.path, *options)
        assert (code, out, err.count("\n")) == (1, "", 1) and "a public store has no answers" in err
    assert not (tmp_path / "report.html").exists()


def test_what_a_public_store_lacks_is_refused_in_a_line(full, tmp_path):
    made = tmp_path / "public"
    export_public(full, made)
    before = sorted(made.rglob("*"))
    for option in ("--rebuild", "--verify"):
        assert "a public store has no labels" in refusal("load", option, "--store", made)
    assert sorted(made.rglob("*")) == before
    demo_runs = run_ids(full)
    stored = pq.read_table(full.run_path(demo_runs[0]) / "predictions.parquet")["question_id"][0].as_py()
    question = opaque_ids(full, [stored])[stored]
    method = (
        "--method",
        "react",
        "--model",
        "simulated:perfect",
        "--questions",
        question,
        "--run-id",
        "own",
        "--no-scores",
    )
    assert "has no annotations" in refusal("evaluate", "--store", made, *method)
    with simulated_server(Sight(full), PERFECT) as url:
        code, _, err = run("evaluate", "--store", made, *method, "--base-url", url)
    assert code == 0 and f"next: jrdb-avr export own --jsonl own.jsonl --store {made}\n" in err
    # The full store reads the opaque ids of its public copy.
    lines, bundle = tmp_path / "lines.jsonl", tmp_path / "bundle"
    assert run("export", "own", "--store", made, "--jsonl", lines)[0] == 0 and question in lines.read_text()
    assert run("submit", "own", bundle, "--store", made)[0] == 0
    assert run("score", "--store", full.path, "--jsonl", lines)[0] == 0
    assert pq.read_table(full.run_path("lines") / "scores.parquet")["question_id"].to_pylist() == [stored]
    (scored,) = score_bundles(full, [bundle]).rows
    (ranked,) = leaderboard(full, [bundle, write_bundle(full, "lines", tmp_path / "second").folder]).sets
    assert scored["n"] == 1 and [row["rank"] for _, row in ranked] == [1, 1]
    assert diff(full, "lines", demo_runs[0]).rows
    twice = tmp_path / "twice.jsonl"
    twice.write_text(lines.read_text() + lines.read_text().replace(question, stored))
    assert "comes twice" in refusal("score", "--store", full.path, "--jsonl", twice)
    for command in (["score", "own"], ["score"], ["report"], ["stats"], ["trace", "own", question]):
        assert "a public store has no answers" in refusal(*command, "--store", made)
    base = ("evaluate", "--store", made, "--method", "react", "--model", "simulated:perfect")
    for options in (["--family", "long_range"], ["--template", "gap"], ["--per-template", "1"]):
        assert "a public store have no" in refusal(*base, *options)


OTHER_USER = ["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups"]
needs_root = pytest.mark.skipif(os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv")


@needs_root
def test_another_user_reads_nothing_of_a_new_store(full):
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        place.chmod(0o755)
        (old := Store(place / "old")).path.mkdir(0o755)
        new = Store(place / "deep" / "new")
        for store in (old, new):
            with store.writing("load"):
                for kind in ("questions", "annotations"):
                    shutil.copytree(full.path / kind, store.path / kind)
        export_public(full, place / "public")
        export_folders(full, place / "hf")

        def readable(path):
            files = path.rglob("*.parquet")
            return {
                subprocess.run([*OTHER_USER, "head", "-c1", file], capture_output=True).returncode for file in files
            }

        assert readable(new.path) == readable(place / "hf" / "private") == {1}
        assert readable(old.path) == readable(place / "public") == readable(place / "hf" / "public") == {0}


@pytest.mark.slow
@needs_root
@pytest.mark.parametrize("opaque", [False, True])
def test_another_user_evaluates_on_a_public_store(full, small_demo, opaque):
    program = [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()"]
    method = ("--method", "react", "--model", "simulated:independent", "--limit", "8", "--no-scores")
    hidden = ["--opaque"] if opaque else []
    assert run("evaluate", "--store", full.path, "--run-id", "own", *method, *hidden)[0] == 0
    # The server is of this user: the other one needs nothing but its address.
    with tempfile.TemporaryDirectory() as folder, simulated_server(Sight(full), None) as url:
        place = Path(folder)
        place.chmod(0o755)
        export_public(full, place / "public", opaque)
        ids = pq.read_table(full.run_path("own") / "predictions.parquet")["question_id"].to_pylist()
        ids = opaque_ids(full, ids).values()
        (place / "public" / "runs").chmod(0o777)
        environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT.parent), "HOME": folder}

        def other(*arguments, command=program):
            return subprocess.run(
                [*OTHER_USER, *command, *map(str, arguments)],
                env=environment,
                cwd=folder,
                capture_output=True,
                text=True,
            )

        if other(command=[*program[:2], "import jrdb_avr.engine.cli"]).returncode:
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
