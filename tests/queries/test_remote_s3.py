"""Everything from `s3://` alone, on a local server of that protocol: what a folder gives, byte by byte."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest
from entry import run
from extras import needs

from jrdb_avr.queries.manifest import Manifest, SequenceEntry
from jrdb_avr.queries.remote import RemoteFolder
from jrdb_avr.queries.store import Store, file_hash
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import LoadRules

needs("moto", "boto3")

STORE = "s3://bucket/store"
TABLE = "annotations/boxes_2d/yard_0.parquet"


@pytest.fixture(scope="module")
def bucket():
    """A client of an empty bucket, which the environment names the server of."""
    import boto3
    from moto.server import ThreadedMotoServer

    with pytest.MonkeyPatch.context() as patch:
        server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
        server.start()
        for name, value in {
            "AWS_ENDPOINT_URL": "http://{}:{}".format(*server.get_host_and_port()),
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_DEFAULT_REGION": "us-east-1",
        }.items():
            patch.setenv(name, value)
        client = boto3.client("s3")
        client.create_bucket(Bucket="bucket")
        yield client
        server.stop()


@pytest.fixture(scope="module")
def made(bucket, tmp_path_factory):
    """A local store, and one at the URL that was made of a root there; two machines' caches."""
    place = tmp_path_factory.mktemp("s3")
    code, _, err = run("sample", place / "root", "--sequences", 1, "--frames", 90, "--people", 6, "--workers", 1)
    assert code == 0, err
    for path in (place / "root").rglob("*"):
        if path.is_file():
            bucket.upload_file(str(path), "bucket", f"root/{path.relative_to(place / 'root')}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JRDB_AVR_CACHE", str(place / "cache"))
        for store, root in ((place / "here", place / "root"), (STORE, "s3://bucket/root")):
            for command in (
                ("load", root, "--workers", 1),
                ("generate", "--profile", "paper", "--workers", 1),
                ("evaluate", "--method", "react", "--model", "simulated", "--limit", 2),
                ("score",),
                ("report",),
            ):
                code, _, err = run(*command, "--store", store)
                assert code == 0, err
    return place


def objects(bucket):
    found = bucket.list_objects_v2(Bucket="bucket", Prefix="store/").get("Contents", [])
    return {entry["Key"].removeprefix("store/"): entry["ETag"] for entry in found}


def test_every_table_is_that_of_a_folder(made, bucket, tmp_path):
    names = {path.relative_to(made / "here").as_posix() for path in (made / "here").rglob("*.parquet")}
    assert names == {name for name in objects(bucket) if name.endswith(".parquet")} and len(names) > 30
    for name in names:
        bucket.download_file("bucket", f"store/{name}", str(tmp_path / "file"))
        # The run's time stands in its predictions and steps.
        if not name.endswith(("predictions.parquet", "steps.parquet")):
            assert file_hash(tmp_path / "file") == file_hash(made / "here" / name), name


def test_another_machine_reads_it_all(made, bucket, tmp_path, monkeypatch):
    monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path))
    people = Store(STORE).sql("SELECT count(*) AS n FROM intervals_persons")["n"][0].as_py()
    _, out, err = run("cypher", "MATCH (p:Person) RETURN count(*) AS n", "--store", STORE, "--csv")
    assert out == f"n\n{people}\n", err
    assert run("runs", "list", "--store", STORE, "--json")[1].count("react-simulated") == 1
    code, _, err = run("validate", "--store", STORE, "--replay", "--workers", 1)
    assert code == 0, err
    code, _, err = run("inspect", "--sample", 1, "--store", STORE, "--out", tmp_path / "page.html")
    assert code == 0 and "1 questions" in err
    assert not [name for name in objects(bucket) if name.startswith("graph")]


KILLED = """
import os, signal, sys
from jrdb_avr.engine.cli import main
from jrdb_avr.queries.mirror import Mirror
last, send = sys.argv.pop(1), Mirror._send_one
def cut(self, name):
    if name.endswith(last):
        os.kill(os.getpid(), signal.SIGKILL)
    return send(self, name)
Mirror._send_one = cut
main()
"""
RUN = ("evaluate", "--method", "react", "--model", "simulated", "--limit", 2, "--run-id", "killed")


@pytest.mark.parametrize(
    ("last", "killed", "look", "seen", "again"),
    [
        (
            "store.json",
            ("load", "s3://bucket/root", "--layer-dir", "pose=", "--workers", 1),
            ("cypher", "MATCH (p:Person) RETURN 1"),
            "is no store",
            ("load", "s3://bucket/root", "--workers", 1),
        ),
        (
            "questions.parquet",
            ("generate", "--profile", "train", "--workers", 1),
            ("score",),
            "of different generations",
            ("generate", "--profile", "paper", "--workers", 1),
        ),
        ("predictions.parquet", RUN, ("runs", "list"), "unfinished", (*RUN, "--resume")),
    ],
)
def test_what_is_killed_while_it_sends_is_done_again(
    made, bucket, tmp_path, monkeypatch, last, killed, look, seen, again
):
    before = objects(bucket)
    monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path / "killed"))
    arguments = [sys.executable, "-c", KILLED, last, *map(str, killed), "--store", STORE]
    assert subprocess.run(arguments, capture_output=True).returncode == -signal.SIGKILL
    # On a machine that knows nothing of it.
    monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path / "other"))
    code, out, err = run(*look, "--store", STORE)
    assert seen in out + err
    code, _, err = run(*again, "--store", STORE)
    assert code == 0, err
    after = objects(bucket)
    assert {name: after[name] for name in before if name.endswith(".parquet")} == {
        name: tag for name, tag in before.items() if name.endswith(".parquet")
    }
    if again[0] == "evaluate":
        assert "runs/killed/predictions.parquet" in after


def test_a_second_writer_is_refused(made, bucket, tmp_path, monkeypatch):
    before = objects(bucket)
    late = Store(STORE)
    monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path))
    assert run("generate", "--store", STORE, "--profile", "train", "--workers", 1)[0] == 0
    between = objects(bucket)
    assert between["questions/questions.parquet"] != before["questions/questions.parquet"]
    monkeypatch.setenv("JRDB_AVR_CACHE", str(made / "cache"))
    with pytest.raises(StoreError, match="changed by another writer"), late.writing("generate"):
        late.question_path("questions").write_bytes(b"of an older store")
    assert objects(bucket) == between


@pytest.mark.parametrize("begun", [False, True])
def test_of_two_writers_at_the_same_moment_one_is_refused(bucket, tmp_path, monkeypatch, begun):
    """Both have passed all comparisons when the other one sends: the server's condition alone tells them apart."""
    place, replace, loads = f"s3://bucket/a%20race/{begun}", RemoteFolder.replace, []

    def load(store, text):
        with store.writing("load"):
            (store.path / "annotations/boxes_2d").mkdir(parents=True, exist_ok=True)
            (store.path / TABLE).write_text(text)
            entries = {"yard_0": SequenceEntry(("2d",), {TABLE: file_hash(store.path / TABLE)})}
            store.write_manifest(Manifest(None, LoadRules(), "", entries, {}))

    def opened(name):
        monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path / name))
        return Store(place)

    def overtaken(self, *arguments):
        if loads:
            load(*loads.pop())
        return replace(self, *arguments)

    if begun:
        load(opened("before"), "before")
    first, second = opened("first"), opened("second")
    loads.append((second, "second"))
    monkeypatch.setattr(RemoteFolder, "replace", overtaken)
    with pytest.raises(StoreError, match=r"changed by another writer since it was read \(turn\)"):
        load(first, "first")
    assert [(opened(name).path / TABLE).read_text() for name in ("other", "first")] == ["second", "second"]
    load(opened("first"), "first")
    load(opened("first"), "again")
    assert (opened("other").path / TABLE).read_text() == "again"


def test_a_server_without_conditions_is_written_to_as_before(bucket, monkeypatch):
    folder, place = RemoteFolder("s3://bucket/plain"), os.environ["AWS_ENDPOINT_URL"]
    assert folder.replace("turn", b"1", None) and folder.replace("turn", b"2", None) is None
    here = RemoteFolder(f"s3://bucket/plain?endpoint_override={place.removeprefix('http://')}&scheme=http")
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    assert here.replace("turn", b"3", here.tag("turn")) == here.tag("turn")
    monkeypatch.setattr("botocore.client.BaseClient._make_api_call", refuse_conditions)
    assert here.replace("turn", b"4", here.tag("turn")) == ""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert here.replace("turn", b"5", None) == "" and here.read("turn") == b"3"


def refuse_conditions(client, operation, arguments):
    from botocore.exceptions import ClientError

    raise ClientError({"Error": {"Code": "NotImplemented"}}, operation)
