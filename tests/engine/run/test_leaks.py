"""What a model could come to know: whole runs of every method, in a process that may open the public files alone.

The private files of the store are pipes, which whoever opens them waits at for ever; its scene holds words and numbers
that stand nowhere else. Every method plays through the marker model; then all that was sent, and all that a run keeps,
is searched for them. The same questions are asked again in a folder that holds nothing but what a machine without
labels is given, and are answered alike.
"""

import json
import os
import re
import shutil
import subprocess
import sys

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from fake_server import recorded_server
from painted import QUESTIONS_ASKED, SEQUENCE, asked_sight

from jrdb_avr.engine.commands.evaluate import command
from jrdb_avr.engine.run.methods import METHODS
from jrdb_avr.queries.beliefs.graph import make_world_tables
from jrdb_avr.queries.graph.handle import build_graph
from jrdb_avr.queries.opaque import opaque_names
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import scene_ddl
from jrdb_avr.schema.tables import PRIVATE

TRACK, LABEL, KEY = 918273, "juggling swordfish", "sk-never-to-be-seen"
SECRETS = (str(TRACK), "swordfish", KEY, "target_track", "proof")
BARE = ("monolithic", "agent")
ASKED = QUESTIONS_ASKED[:1]

METADATA = {"sequence", "frame_index", "frame_id", "timestamp", "angle_deg", "fov_deg", "left"}
"""What `Observation` and `Panorama` say beside their pixels."""

PROGRAM = """
import sys
from jrdb_avr.engine.cli import main
for line in sys.stdin:
    sys.argv = ["jrdb-avr", *line.split()]
    main()
"""


PLAYERS = (*METHODS, "agent --advice off")


def run_of(player):
    return player.replace(" --", "-").replace(" ", "-")


def evaluate_all(store, url, players, *options):
    """A run of each method, in a process of their own; fails where one fails or waits for ever."""
    lines = []
    for player in players:
        lines.append(
            f"evaluate --store {store.path} --method {player} --model simulated:perfect --simulated --base-url {url} "
            f"--run-id {run_of(player)} --limit {len(ASKED)} --concurrency 2 {' '.join(options)}\n"
        )
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input="".join(lines),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env={"PATH": "/usr/bin:/bin", "OPENAI_API_KEY": KEY},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def marker():
    """A marker server in this process that keeps what it is sent."""
    with recorded_server(asked_sight()) as recorded:
        yield recorded


@pytest.fixture(scope="module")
def full(asked_world, tmp_path_factory, marker):
    """A store with private files, after a run of every method; what was printed."""
    path = tmp_path_factory.mktemp("leaks") / "store"
    shutil.copytree(asked_world / "store", path)
    store = Store(path)
    for name in PRIVATE:
        os.mkfifo(store.question_path(name))
    with build_graph(store.graph_path) as graph:
        for statement in scene_ddl():
            graph.execute(statement)
        make_world_tables(graph)
        graph.execute(
            "CREATE (:Person {id: $id, track: $track, gender: $label})",
            {
                "id": f"painted/{TRACK}",
                "track": TRACK,
                "label": LABEL,
            },
        )
        graph.execute("CREATE (:Action {name: $label, pose: true})", {"label": LABEL})
    return store, evaluate_all(store, marker[0], PLAYERS)


def kept(store, method):
    """All that a run keeps, as text."""
    folder = store.run_path(method)
    tables = [pq.read_table(path).to_pylist() for path in sorted(folder.glob("*.parquet"))]
    files = {path.name: path.read_text() for path in folder.rglob("*") if path.suffix in (".json", ".jsonl")}
    assert len(tables) == 3
    assert {"run.json", f"{SEQUENCE}.jsonl", "calls.jsonl"} <= files.keys()
    return json.dumps(tables) + "".join(files.values())


def said(body):
    """The texts of a request; its pictures are pixels."""
    for message in json.loads(body)["messages"]:
        content = message["content"]
        yield from [content] if isinstance(content, str) else [p["text"] for p in content if p["type"] == "text"]


@pytest.mark.slow
def test_every_method_plays_and_keeps_nothing_private(full):
    store, printed = full
    for method in map(run_of, PLAYERS):
        text = kept(store, method) + printed
        assert not [secret for secret in (*SECRETS, "base64") if secret in text], method
        table = pq.read_table(store.run_path(method) / "predictions.parquet")
        assert len(table) == len(ASKED)
        assert "error" not in table["status"].to_pylist(), table["reason"].to_pylist()


@pytest.mark.slow
def test_who_opens_a_private_file_waits_for_ever(full):
    """So the runs above, which came to their end, have not."""
    read = "import sys, pyarrow.parquet as pq; print('here', flush=True); pq.ParquetFile(sys.argv[1])"
    command = [sys.executable, "-c", read, str(full[0].question_path("answers"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout.readline() == "here\n"
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.5)
        process.kill()


@pytest.mark.slow
def test_nothing_private_is_sent(full, marker):
    sent = [text for body in marker[1] for text in said(body)]
    assert len(sent) > 25
    assert not [secret for secret in SECRETS if any(secret in text for text in sent)]


@pytest.mark.slow
def test_no_request_names_a_sequence(full, marker):
    assert not [text for body in marker[1] for text in said(body) if SEQUENCE in text]


@pytest.fixture(scope="module")
def opaque(asked_world, tmp_path_factory, marker):
    """A store without labels after an opaque run of every method, and the requests that they sent."""
    store = Store(tmp_path_factory.mktemp("opaque") / "store")
    (store.path / "questions").mkdir(parents=True)
    for name in ("questions", "sequences"):
        shutil.copy(asked_world / "store" / "questions" / f"{name}.parquet", store.question_path(name))
    before = len(marker[1])
    evaluate_all(store, marker[0], PLAYERS, "--images", str(asked_world / "images"), "--opaque")
    return store, marker[1][before:]


@pytest.mark.slow
def test_opaque_runs_answer_and_never_hold_the_real_name(opaque, full):
    store, sent = opaque
    own = opaque_names(store, [SEQUENCE])[SEQUENCE]
    assert len(sent) > 25 and not [text for body in sent for text in said(body) if SEQUENCE in text]
    for method in map(run_of, PLAYERS):
        text = kept(store, method)
        assert SEQUENCE not in text and own in text, method
        here, there = (pq.read_table(s.run_path(method) / "predictions.parquet") for s in (store, full[0]))
        # What is predicted, and under which id, does not change.
        assert here.drop_columns(["seconds"]).equals(there.drop_columns(["seconds"])), method


@pytest.mark.slow
def test_what_is_said_of_a_picture_is_what_its_observation_says(full, marker):
    announced = [
        json.loads(found[1])
        for body in marker[1]
        for text in said(body)
        for found in re.finditer(r"^(?:Picture|Panorama|Crop)[^{\n]*: (\{.*\})$", text, re.MULTILINE)
    ]
    assert len(announced) > 15
    assert set().union(*announced) <= METADATA


@pytest.mark.slow
def test_a_folder_without_labels_gives_the_same_predictions(full, marker, asked_world, tmp_path):
    """Two files of questions and the panoramas; the world model in a graph of its own."""
    store, _ = full
    bare = Store(tmp_path / "bare")
    (bare.path / "questions").mkdir(parents=True)
    for name in ("questions", "sequences"):
        shutil.copy(store.question_path(name), bare.question_path(name))
    evaluate_all(bare, marker[0], BARE, "--images", str(asked_world / "images"))
    assert not (bare.path / "store.json").exists()
    assert not bare.graph_path.exists()
    for method in BARE:
        for name in ("predictions", "steps", "world"):
            here, there = (pq.read_table(s.run_path(method) / f"{name}.parquet") for s in (bare, store))
            dropped = [c for c in ("seconds",) if c in here.column_names]
            assert here.drop_columns(dropped).equals(there.drop_columns(dropped)), (method, name)


def test_what_a_folder_without_labels_lacks_is_one_line(asked_world, tmp_path):
    bare = tmp_path / "bare" / "questions"
    bare.mkdir(parents=True)
    for name in ("questions", "sequences"):
        shutil.copy(asked_world / "store" / "questions" / f"{name}.parquet", bare)
    options = ["--model", "simulated:perfect", "--method", "react"]
    result = CliRunner().invoke(command, ["--store", str(tmp_path / "bare"), *options])
    assert isinstance(result.exception, StoreError)
    assert "--images" in str(result.exception)
