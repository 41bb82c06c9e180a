"""Runs on a Ray cluster of this machine: what they predict, and what becomes of workers, questions and limits."""

import os
import signal
from collections import Counter
from itertools import pairwise
from pathlib import Path

import msgspec
import pyarrow.parquet as pq
import pytest
from asked_world import FRAMES, QUESTIONS_ASKED, question, write_public
from entry import run
from fake_server import FakeServer, sound, texts
from painted_world import SEQUENCE

from jrdb_avr.agent.model.cache import call_files
from jrdb_avr.agent.model.options import Options
from jrdb_avr.agent.model.prices import Price
from jrdb_avr.engine.run import on_cluster
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.opaque import key_path
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.schema.errors import RunStoppedError
from jrdb_avr.schema.tables import PRIVATE

IDS = [asked.question_id for asked in QUESTIONS_ASKED]

METHOD = """
import os, time
from pathlib import Path
from jrdb_avr.schema.method import Prediction
class Own:
    name = "own"
    def __init__(self, chat):
        self.chat = chat
    def answer(self, task):
        question = task.question.question_id
        with (Path({place!r}) / question).open("a") as file:
            file.write(f"{{time.monotonic()}} {{os.getpid()}}\\n")
        {line}
        return Prediction("invalid", raw=str(task.observe(task.sequence.sequence, 0, 180.0).left))
"""


@pytest.fixture(scope="module", autouse=True)
def ray():
    if "REQUIRE_EXTRAS" not in os.environ:
        pytest.importorskip("ray", minversion="2")  # not a mere folder of that name
    import ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()


@pytest.fixture
def own(tmp_path):
    """Makes the name of an own method that carries out a line in each question, and notes when and where."""
    (tmp_path / "seen").mkdir()

    def made(line):
        (tmp_path / "own.py").write_text(METHOD.format(place=str(tmp_path / "seen"), line=line))
        return f"{tmp_path / 'own.py'}:Own"

    return made


def seen(tmp_path):
    """Per question: when it was begun, and in which process."""
    return {path.name: [line.split() for line in path.open()] for path in (tmp_path / "seen").iterdir()}


def counted(result):
    row = result.row()
    return row["n"], row["invalid"], row["error"]


def tables(store, run_id):
    """A run's tables without what differs from run to run: its id, and seconds."""
    read = [pq.read_table(store.run_path(run_id) / f"{name}.parquet") for name in ("predictions", "steps", "world")]
    kept = [table.drop_columns(list({"seconds", "run_id"} & set(table.column_names))) for table in read]
    return [str(table.to_pylist()).replace(run_id, "RUN") for table in kept]


def workers():
    """The processes of workers."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        if path.read_bytes().startswith(b"ray::_Actor"):
            yield int(path.parent.name)


@pytest.mark.parametrize(("method", "opaque", "kills"), [("react", True, 1), ("agent", False, 0)])
def test_a_run_on_a_cluster_predicts_what_one_here_does(store, tmp_path, monkeypatch, method, opaque, kills):
    """Also where a worker is killed. It opens nothing private, as who opens these pipes waits for ever, and is sent
    neither the key of opaque names nor the place of the store."""
    for name in PRIVATE:
        os.mkfifo(store.question_path(name))
    chosen = {"questions": IDS[:6], "opaque": opaque, "concurrency": 1}
    world = {"world_db": tmp_path / "world.kuzu"} if method == "agent" else {}
    evaluate(store, method, "simulated", run_id="run-here", **chosen, **world)
    sent, left = [], [kills]
    start = on_cluster.ClusterMethod._start

    def noted(self, seat):
        sent.extend([msgspec.json.encode(self._job), self._ray.get(self._assignment)])
        start(self, seat)

    def progress(what, done, total):
        if done == 2 and left[0]:
            left[0] -= 1
            os.kill(next(workers()), signal.SIGKILL)

    monkeypatch.setattr(on_cluster.ClusterMethod, "_start", noted)
    result = evaluate(store, method, "simulated", run_id="run-away", **chosen, executor="ray", progress=progress)
    assert counted(result)[2] == 0 and left == [0] and len(sent) == 2 * (2 + kills)
    assert tables(store, "run-here") == tables(store, "run-away")
    here, away = (read_run_manifest(store, run_id) for run_id in ("run-here", "run-away"))
    # The addresses of the simulated model alone differ.
    del here.settings["endpoint"]["base_url"], away.settings["endpoint"]["base_url"]
    assert (here.settings, here.world) == (away.settings, away.world)
    text = b"".join(sent).decode()
    assert text.count(str(store.path)) == text.count('"calls"') == 2 + kills
    assert not opaque or key_path(store).read_text() not in text


def test_a_question_that_kills_its_worker_is_an_error_and_no_other_one_is(store, own, tmp_path):
    """What was at work beside it is asked again, one at a time: nothing else dies of it twice."""
    killer = IDS[1]
    line = f"time.sleep(0.1); question == {killer!r} and os._exit(1)"
    result = evaluate(store, own(line), run_id="r", executor="ray", concurrency=4)
    assert counted(result) == (12, 11, 1) and "died 4 times" in result.commonest_reason("error")[0]
    times = {name: len(begun) for name, begun in seen(tmp_path).items()}
    assert times.pop(killer) == 4 and set(times) == set(IDS) - {killer} and max(times.values()) == 2
    assert counted(evaluate(store, own("pass"), run_id="r", resume=True)) == (12, 12, 0)


def test_a_worker_keeps_to_its_sequence(store, own, tmp_path):
    """Twelve questions of three sequences, in turn in the file: no worker comes back to a sequence."""
    questions = [question(t0, 150, name) for t0 in range(0, 60, 15) for name in "abc"]
    write_public(store, questions, dict.fromkeys("abc", FRAMES))
    (tmp_path / "images").mkdir()
    for name in "abc":
        (tmp_path / "images" / name).symlink_to(Path(store.manifest().image_root) / SEQUENCE)
    evaluate(store, own("time.sleep(0.1)"), images=tmp_path / "images", executor="ray", concurrency=1)
    sequence = {asked.question_id: asked.sequence for asked in questions}
    visits = sorted((*at, sequence[name]) for name, (at,) in seen(tmp_path).items())
    for process in {process for _, process, _ in visits}:
        names = [name for _, own, name in visits if own == process]
        assert sum(one != other for one, other in pairwise(names)) <= 2, visits


def test_limits_are_those_of_the_run_and_finished_calls_are_found_again(store, own, tmp_path):
    # Both workers have begun before any question ends.
    line = """from jrdb_avr.agent.model.messages import Message
        while len({line.split()[1] for path in Path(__file__).with_name("seen").iterdir() for line in path.open()}) < 2:
            time.sleep(0.01)
        self.chat.complete([Message("user", (question,))])"""
    with FakeServer(sound(lambda request, n: "hi")) as server:
        chosen = {"model": "fake", "base_url": server.url, "run_id": "r"}
        # A call costs 0.1 dollars; eleven check the server for each worker. Neither spends as much by itself.
        options = Options(rpm=1000, price=Price(10_000, 0), max_cost=2.45)
        with pytest.raises(RunStoppedError, match=r"--max-cost is 2\.45"):
            evaluate(store, own(line), **chosen, options=options, executor="ray", concurrency=1)
        assert read_run_manifest(store, "r").settings["endpoint"]["rpm"] == 1000
        assert 0 < len(seen(tmp_path)) <= 5
        kept = call_files(store.run_path("r"))
        assert kept and all(path.name != "calls.jsonl" for path in kept)
        options = Options(price=Price(10_000, 0))
        assert counted(evaluate(store, own(line), **chosen, options=options, resume=True)) == (12, 12, 0)
        assert [path.name for path in call_files(store.run_path("r"))] == ["calls.jsonl"]
        asked = Counter(map(texts, server.requests))
        assert {name: asked[name] for name in IDS} == dict.fromkeys(IDS, 1)


def test_an_interrupted_run_leaves_no_worker_and_is_finished_here(store, own, tmp_path):
    def interrupt(what, done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate(store, own("time.sleep(0.1)"), run_id="r", executor="ray", concurrency=1, progress=interrupt)
    begun = {int(process) for begun in seen(tmp_path).values() for _, process in begun}
    while any(Path(f"/proc/{process}").exists() for process in begun):
        pass
    assert counted(evaluate(store, own("pass"), run_id="r", resume=True)) == (12, 12, 0)
    assert sum(map(len, seen(tmp_path).values())) <= 12 + len(begun)


@pytest.mark.parametrize("fault", ["isolated", "world_db"])
def test_what_a_cluster_cannot_do_is_refused(store, fault):
    option = {"isolated": ("--isolated",), "world_db": ("--world-db", "w.kuzu")}[fault]
    code, _, err = run(
        "evaluate", "--store", store.path, "--method", "agent", "--model", "simulated", "--executor", "ray", *option
    )
    assert code == 2 and "--executor" in err
