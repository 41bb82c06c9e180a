"""Methods in a process of their own: they play as they would in the run's, and find nothing but the public files."""

import errno
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import warm
from asked_world import QUESTIONS_ASKED
from entry import run
from segments import segment_of

from jrdb_avr.engine.run import confine
from jrdb_avr.engine.run.isolated import check_confinable
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

SECRET = "gold 918273"

try:
    check_confinable()
    CONFINES = True
except StoreError:
    CONFINES = False

isolates = pytest.mark.skipif(not CONFINES, reason="this kernel has no Landlock, so --isolated is refused")

THIEF = """
import os, subprocess
from pathlib import Path
from jrdb_avr.schema.method import Prediction

def tried(what):
    try:
        return what()
    except OSError:
        return b""

class Thief:
    name = "thief"
    def __init__(self, chat): pass
    def answer(self, task):
        store, parent = Path({store!r}), os.getppid()
        seen = [repr(os.environ).encode()]
        open_files = [Path("/proc", str(process), "fd") for process in (parent, os.getpid())]
        for top in (store, store.parent, *open_files):
            for folder, _, names in tried(lambda: list(os.walk(top))) or ():
                seen += [tried(Path(folder, name).read_bytes) for name in names if Path(folder, name).is_file()]
        # It knows every path by heart.
        for path in (*{private!r}, f"/proc/{{parent}}/environ", f"/proc/{{parent}}/maps", "/etc/passwd"):
            seen.append(tried(lambda: Path(path).read_bytes()))
            seen.append(subprocess.run(["/bin/cat", path], capture_output=True).stdout)
            tried(lambda: os.link(path, "answers") or b"")
        secrets = (b"gold 918273", b"root:x:", b"AVR_STORE")
        found = [str(len(seen)), *(text.decode() for text in secrets if text in b"".join(seen))]
        for name, attempt in {{
            "signal": lambda: os.kill(parent, 0), "write": lambda: (store / "left").write_text("x"),
            "mount": lambda: os.chroot("/"), "user": lambda: os.setgroups(os.getgroups()),
        }}.items():
            try:
                attempt()
                found.append(name)
            except OSError:
                pass
        look = task.observe(task.sequence.sequence, 0, 180.0)
        return Prediction("invalid", reason=" ".join(found), raw=str(look.image.shape))
"""


def private_files(store):
    """Files that hold the secret, of every kind that a store and the root beside the panoramas have."""
    image_root = store.path.parent / "root" / "images" / "image_stitched"
    places = [
        *(store.question_path(name) for name in ("answers", "evidence", "proofs")),
        store.path / "graph.kuzu",
        store.annotation_path("boxes_2d", "s"),
        segment_of(store.run_path("other")),
        image_root.parents[1] / "labels" / "labels_3d" / "s.json",
    ]
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(SECRET)
    return image_root, [str(place) for place in places]


@pytest.fixture
def secret(store, asked_world):
    """A store with private files, the panoramas in a root that has labels, and where the files are."""
    image_root, places = private_files(store)
    shutil.copytree(asked_world / "images", image_root)
    return store, image_root, places


def evaluate(store, *options):
    code, out, err = run("evaluate", "--store", store.path, "--json", "--limit", "2", *options)
    return code, json.loads(out) if out else None, err


def evaluate_alone(store, *options):
    """The same in a process of its own: the thief reads and tries what could end the process of the tests."""
    asked = ["evaluate", "--store", store.path, "--json", "--limit", "2", *options]
    done = subprocess.run(
        [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()", *map(str, asked)],
        capture_output=True,
        text=True,
        timeout=120,
        # The thief leaves links where it works.
        cwd=store.path.parent,
    )
    return done.returncode, json.loads(done.stdout) if done.stdout else None, done.stderr


def test_without_isolation_the_search_finds_the_answers(secret, tmp_path):
    """So the test below would notice."""
    assert "gold" in stolen(secret, tmp_path)


@isolates
def test_an_isolated_method_that_searches_finds_no_answer(secret, tmp_path, monkeypatch):
    monkeypatch.setenv("JRDB_AVR_STORE", str(secret[0].path))
    words = stolen(secret, tmp_path, "--isolated").split()
    assert int(words[0]) > 15 and words[1:] == []
    assert sorted(path.name for path in secret[0].run_path("r").iterdir()) == sorted(
        ["calls.jsonl", "journal", "run.json", *(f"{name}.parquet" for name in ("predictions", "steps", "world"))]
    )
    assert not (secret[0].path / "left").exists()


def stolen(secret, tmp_path, *options):
    """The reason of the thief's predictions, which looks at a picture after its search."""
    store, image_root, places = secret
    (tmp_path / "thief.py").write_text(THIEF.format(store=str(store.path), private=places))
    method = ("--method", f"{tmp_path / 'thief.py'}:Thief", "--model", "none", "--run-id", "r")
    code, rows, err = evaluate_alone(store, *method, "--images", image_root, *options)
    assert code == 0, err
    (row,) = rows
    assert (row["n"], row["invalid"]) == (2, 2), err
    rows = store.sql("SELECT DISTINCT reason, raw FROM predictions").to_pylist()
    assert {row["raw"] for row in rows} == {"(480, 480, 3)"}
    return rows[0]["reason"]


@isolates
@pytest.mark.parametrize("options", [("react", "--opaque"), ("agent",)])
def test_an_isolated_method_predicts_what_it_would_in_the_process_of_the_run(store, options, tmp_path):
    options = ("--model", "simulated", "--concurrency", "2", "--method", *options)
    graph = ("--world-db", tmp_path / "world.kuzu") if "agent" in options else ()
    assert evaluate(store, *options, "--run-id", "run-here", *graph)[0] == 0
    code, (row,), err = evaluate(store, *options, "--run-id", "run-away", "--isolated")
    assert (code, row["n"], row["error"]) == (0, 2, 0), err
    here, away = (read_run_manifest(store, run_id) for run_id in ("run-here", "run-away"))
    for table in ("predictions", "steps", "world"):
        names = store.sql(f"SELECT * FROM {table} LIMIT 0").column_names
        columns = ", ".join(name for name in names if name != "seconds")
        first, second = (
            str(store.sql(f"SELECT {columns} FROM {table} WHERE run_id = '{r.run_id}' ORDER BY ALL").to_pylist())
            for r in (here, away)
        )
        assert first.replace("run-here", "run-away") == second
        assert len(second) > 50 or (table == "world" and not graph)
    assert here.world == away.world
    # The address of the simulated model alone differs.
    del here.settings["endpoint"]["base_url"], away.settings["endpoint"]["base_url"]
    assert here.settings == away.settings


BAD = {
    "raise SystemExit(0)": ("a row", "SystemExit"),
    "os._exit(0)": ("an end", "the isolated process has ended"),
    "[os.write(n, b'{}\\n') for n in range(3, 300) if is_pipe(n)]": ("an end", "sent what is no answer"),
}


@isolates
@pytest.mark.parametrize("line", BAD)
def test_whatever_an_isolated_method_does_the_run_is_whole(store, asked_world, tmp_path, line, monkeypatch):
    text = f"""
import os, stat
from jrdb_avr.schema.method import Prediction
def is_pipe(n):
    try:
        return stat.S_ISFIFO(os.fstat(n).st_mode)
    except OSError:
        return False
class Bad:
    name = "bad"
    def __init__(self, chat): pass
    def answer(self, task):
        if task.question.question_id == {QUESTIONS_ASKED[1].question_id!r}:
            {line}
        return Prediction("invalid")
"""
    (tmp_path / "bad.py").write_text(text)
    # Paths as a person writes them, which mean nothing in the folder of the process.
    monkeypatch.chdir(tmp_path)
    store, images = Store(store.path.relative_to(tmp_path)), os.path.relpath(asked_world / "images")
    method = ("--method", "bad.py:Bad", "--model", "none", "--run-id", "r", "--isolated", "--images", images)
    code, _, err = evaluate(store, *method, "--concurrency", "1")
    assert code == 1 and err.splitlines()[-1].count(BAD[line][1]) == 1
    (tmp_path / "bad.py").write_text(text.replace(line, "pass"))
    code, (row,), err = evaluate(store, *method, "--resume")
    assert (row["n"], row["invalid"]) == (2, 2), err


@isolates
def test_an_isolated_method_ends_with_the_run_that_is_killed(store, tmp_path, asked_world):
    (tmp_path / "slow.py").write_text(
        """
import time
class Slow:
    name = "slow"
    def __init__(self, chat): pass
    def answer(self, task):
        print("begun", flush=True)
        time.sleep(30)
"""
    )
    method = (
        "--method",
        tmp_path / "slow.py:Slow",
        "--model",
        "none",
        "--isolated",
        "--images",
        asked_world / "images",
    )
    (tmp_path / "err").touch()
    process = warm.started(warm.command_line, "evaluate", "--store", store.path, *method, folder=tmp_path)
    try:
        while b"begun" not in (tmp_path / "err").read_bytes():
            assert process.is_alive()
            time.sleep(0.02)
        (isolated,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    finally:
        process.kill()
    # Its state is Z while nobody has asked how it ended.
    while Path(f"/proc/{isolated}/stat").exists() and ") Z " not in Path(f"/proc/{isolated}/stat").read_text():
        time.sleep(0.02)


def test_where_nothing_can_be_isolated_the_run_is_refused_in_a_line(store, monkeypatch):
    monkeypatch.setattr(confine, "_version", lambda: 0)
    code, _, err = evaluate(store, "--method", "react", "--model", "simulated", "--isolated")
    assert code == 1 and "cannot confine" in err.splitlines()[-1] and "Traceback" not in err


@isolates
def test_a_store_among_the_programs_is_refused_in_a_line():
    with pytest.raises(StoreError, match="holds programs"):
        confine.program_files([Store(os.path.realpath(os.__file__)).path])


@isolates
def test_what_cannot_be_prepared_is_refused_in_a_line(store, monkeypatch):
    def full(*values, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryDirectory", full)
    code, _, err = evaluate(store, "--method", "docs/examples/blind.py:Blind", "--model", "none", "--isolated")
    assert code == 1 and "cannot be prepared" in err.splitlines()[-1] and "Traceback" not in err


def test_on_a_machine_of_unknown_calls_nothing_is_confined(monkeypatch):
    monkeypatch.setattr(confine, "_CAPSET", None)
    with pytest.raises(StoreError, match="cannot confine"):
        confine.check_confinable()
