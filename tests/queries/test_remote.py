"""Stores at a URL, here a folder's: what is fetched, sent, refused and kept."""

from __future__ import annotations

import shutil

import pyarrow.fs as pafs
import pytest
from entry import run
from fsspec.implementations.local import LocalFileSystem

from jrdb_avr.queries import mirror, remote
from jrdb_avr.queries.manifest import Manifest, SequenceEntry
from jrdb_avr.queries.mirror import Mirror
from jrdb_avr.queries.store import Store, file_hash
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.rules import LoadRules

TABLE = "annotations/boxes_2d/yard_0.parquet"


@pytest.fixture
def there(tmp_path):
    (tmp_path / "there").mkdir()
    return tmp_path / "there"


@pytest.fixture
def machine(tmp_path, there, monkeypatch):
    """A function that opens the store as another machine, which has a cache of its own."""

    def opened(name):
        monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path / name))
        return Store(there.as_uri())

    return opened


def write(store, path, text):
    place = store.path / path
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text)
    return place


def load(store, text, sequence="yard_0"):
    """Write a table and its manifest as a load does."""
    with store.writing("load"):
        shutil.rmtree(store.path / "annotations", ignore_errors=True)
        digest = file_hash(write(store, TABLE.replace("yard_0", sequence), text))
        entries = {sequence: SequenceEntry(("2d",), {TABLE.replace("yard_0", sequence): digest})}
        store.write_manifest(Manifest(None, LoadRules(), "", entries, {}))


def files(folder):
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


def test_what_one_machine_writes_another_reads(machine, there):
    load(machine("a"), "boxes")
    assert files(there).keys() == {TABLE, "store.json"}
    other = machine("b")
    assert (other.path / TABLE).read_text() == "boxes" and list(other.manifest().sequences) == ["yard_0"]
    # A load of another sequence takes the first one's table away, on every machine.
    load(other, "more", "hall_0")
    assert TABLE not in files(there)
    assert not (machine("a").path / TABLE).exists()


def test_only_what_differs_is_sent_and_fetched(machine, there, monkeypatch):
    store = machine("a")
    load(store, "boxes")
    before = (there / TABLE).stat().st_mtime_ns
    load(store, "boxes")  # The same table, written anew.
    assert (there / TABLE).stat().st_mtime_ns == before
    fetched = []
    monkeypatch.setattr(Mirror, "fetch_file", lambda self, name: fetched.append(name) or name)
    machine("a")
    assert fetched == []


def test_a_writer_who_read_an_older_manifest_is_refused(machine, there):
    load(machine("a"), "boxes")
    first, second = machine("a"), machine("b")
    load(first, "first")
    kept = files(there)
    with pytest.raises(
        StoreError, match=r"changed by another writer since it was read \(annotations/.*run the command"
    ):
        load(second, "second")
    assert files(there) == kept
    # Opened again it is what the first one wrote, and can be written.
    second = machine("b")
    assert (second.path / TABLE).read_text() == "first"
    load(second, "second")
    assert files(there)[TABLE] == "second"


def test_questions_are_not_sent_beside_tables_of_another_load(machine, there):
    load(machine("a"), "boxes")
    first, second = machine("a"), machine("b")
    with pytest.raises(StoreError, match=r"store\.json"), second.writing("generate"):
        write(second, "questions/questions.parquet", "questions")
        load(first, "other boxes")
    assert "questions/questions.parquet" not in files(there)


def test_evidence_that_is_no_longer_used_is_gone_before_the_new_questions_are_there(machine, there, monkeypatch):
    """A command that is killed at any time leaves no evidence beside questions that have none there."""
    store = machine("a")
    load(store, "boxes")
    with store.writing("generate"):
        for name in ("yard_0", "hall_0"):
            write(store, f"questions/evidence/{name}.parquet", name)
        write(store, "questions/questions.parquet", "of both")
    send_one, seen = Mirror._send_one, {}

    def observed(self, name):
        seen[name] = files(there)
        return send_one(self, name)

    monkeypatch.setattr(Mirror, "_send_one", observed)
    with store.writing("generate"):
        (store.path / "questions/evidence/hall_0.parquet").unlink()
        write(store, "questions/evidence/yard_0.parquet", "anew")
        write(store, "questions/questions.parquet", "of one")
    assert seen["questions/evidence/yard_0.parquet"]["questions/questions.parquet"] == "of both"
    assert "questions/evidence/hall_0.parquet" not in seen["questions/questions.parquet"]


def test_a_send_that_is_cut_off_leaves_no_store_of_two_loads(machine, there, monkeypatch):
    load(machine("a"), "boxes")
    store = machine("a")
    send = Mirror._send_one

    def cut(self, name):
        if name == "store.json":
            raise KeyboardInterrupt
        return send(self, name)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Mirror, "_send_one", cut)
        load(store, "newer")
    with pytest.raises(StoreError, match="is no store"):
        machine("b").manifest()
    # The same load once more completes it.
    load(machine("a"), "newer")
    store = machine("b")
    assert (store.path / TABLE).read_text() == "newer" and store.manifest()


def test_what_a_command_leaves_that_was_killed_before_it_sent_is_undone(machine, there):
    load(machine("a"), "boxes")
    store = machine("a")
    write(store, TABLE, "half")
    write(store, "questions/answers.parquet", "half")
    write(store, "graph.kuzu", "of the tables there")
    store = machine("a")
    assert files(store.path / "annotations") == {"boxes_2d/yard_0.parquet": "boxes"}
    assert not (store.path / "questions/answers.parquet").exists() and (store.path / "graph.kuzu").exists()
    load(machine("b"), "newer")
    assert not (machine("a").path / "graph.kuzu").exists()


def test_answers_that_a_killed_run_could_not_send_are_kept(machine, there):
    load(machine("a"), "boxes")
    store = machine("a")
    with store.sending("runs/mine/"):
        write(store, "runs/mine/journal.jsonl", "one\n")
    write(store, "runs/mine/journal.jsonl", "one\ntwo\n")
    write(store, "runs/young/journal.jsonl", "killed before it sent anything\n")
    store = machine("a")
    assert (store.path / "runs/young/journal.jsonl").exists()
    with store.sending("runs/mine/"):
        pass
    assert files(there)["runs/mine/journal.jsonl"] == "one\ntwo\n"
    # Where the run went on elsewhere too, that one counts; the answers here are kept beside it.
    write(store, "runs/mine/journal.jsonl", "one\ntwo\nhere\n")
    other = machine("b")
    with other.sending("runs/mine/"):
        write(other, "runs/mine/journal.jsonl", "one\ntwo\nelsewhere\n")
    store = machine("a")
    assert files(store.path / "runs/mine") == {
        "journal.jsonl": "one\ntwo\nelsewhere\n",
        ".journal.jsonl.unsent": "one\ntwo\nhere\n",
    }


def begin(store, when, sequences, text):
    """Write a run's manifest and answers."""
    write(store, "runs/mine/run.json", f'{{"created": "{when}", "answers": {len(text)}}}')
    for name in sequences:
        write(store, f"runs/mine/journal/{name}.jsonl", f"{text}\n")


def test_answers_of_another_run_under_one_id_are_not_mixed(machine, there):
    first, second = machine("a"), machine("b")
    with first.sending("runs/mine/"):
        begin(first, "8:00", ["yard"], "one")
    with pytest.raises(StoreError, match="changed by another writer"), second.sending("runs/mine/"):
        begin(second, "8:01", ["yard", "hall"], "two")
    second = machine("b")
    sent = files(first.path / "runs/mine")
    kept = {".run.json.unsent", "journal/.yard.jsonl.unsent", "journal/.hall.jsonl.unsent"}
    assert {name: text for name, text in files(second.path / "runs/mine").items() if name not in kept} == sent
    assert files(second.path / "runs/mine").keys() == sent.keys() | kept
    with second.sending("runs/mine/"):
        pass
    assert files(there / "runs/mine") == sent
    # A run that was begun anew takes no answers to other sequences either.
    with first.sending("runs/mine/"):
        begin(first, "8:02", ["yard"], "three")
    with pytest.raises(StoreError, match="changed by another writer"), second.sending("runs/mine/"):
        write(second, "runs/mine/journal/hall.jsonl", "one\n")
    machine("b")
    assert files(there / "runs/mine") == files(first.path / "runs/mine")
    assert files(second.path / "runs/mine").keys() == sent.keys() | kept


def test_a_run_that_is_killed_after_it_sent_a_file_goes_on(machine, there):
    store = machine("a")
    begin(store, "8:00", ["yard", "hall"], "one")
    # Sent, and not noted.
    shutil.copytree(store.path / "runs", there / "runs")
    begin(store, "8:00", ["yard"], "one\ntwo")
    store = machine("a")
    here = files(store.path / "runs/mine")
    assert here["journal/yard.jsonl"] == "one\ntwo\n" and here.keys() == files(there / "runs/mine").keys() | {
        ".run.json.unsent"
    }
    with store.sending("runs/mine/"):
        pass
    assert (there / "runs/mine/journal/yard.jsonl").read_text() == "one\ntwo\n"


def test_what_was_sent_before_a_file_failed_is_no_other_writers(machine, there, monkeypatch):
    store, send = machine("a"), mirror.RemoteFolder.send

    def fail(self, path, name):
        if name.endswith("yard.jsonl"):
            raise StoreError("the network")
        send(self, path, name)

    monkeypatch.setattr(mirror.RemoteFolder, "send", fail)
    with pytest.raises(StoreError, match="the network"), store.sending("runs/mine/"):
        begin(store, "8:00", ["yard", "hall"], "one")
    assert files(there).keys() == {"runs/mine/run.json", "runs/mine/journal/hall.jsonl"}
    monkeypatch.setattr(mirror.RemoteFolder, "send", send)
    with store.sending("runs/mine/"):
        begin(store, "8:00", ["yard", "hall"], "one\ntwo")
    assert files(there / "runs") == files(store.path / "runs")


def test_a_run_sends_its_journal_while_it_goes_on_and_when_it_fails(machine, there, monkeypatch):
    monkeypatch.setattr(mirror, "SEND_EVERY_S", 0.01)
    store = machine("a")
    with pytest.raises(ZeroDivisionError), store.sending("runs/mine/"):
        write(store, "runs/mine/journal.jsonl", "one\n")
        while not (there / "runs/mine/journal.jsonl").exists():
            pass
        write(store, "runs/mine/journal.jsonl", "one\ntwo\n")
        raise ZeroDivisionError
    assert files(there)["runs/mine/journal.jsonl"] == "one\ntwo\n"


def test_of_a_journal_the_files_that_changed_are_sent(machine, there, monkeypatch):
    sent, send = [], mirror.RemoteFolder.send
    store = machine("a")
    monkeypatch.setattr(
        mirror.RemoteFolder, "send", lambda self, path, name: (sent.append(name), send(self, path, name))
    )
    for name in ("yard", "hall", "yard"):
        with store.sending("runs/mine/"):
            path = store.path / f"runs/mine/journal/{name}.jsonl"
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a") as file:
                file.write("a line\n")
    assert sent == [f"runs/mine/journal/{name}.jsonl" for name in ("yard", "hall", "yard")]
    assert files(there)["runs/mine/journal/yard.jsonl"] == "a line\n" * 2


def test_no_name_in_a_listing_leads_out_of_the_mirror(machine, there, tmp_path, monkeypatch):
    load(machine("a"), "boxes")
    names = ["../out", "runs/../../../out", "/etc/out", "runs//out", "runs/x\n/out", ".writing", "runs/.hidden", "out"]

    class Listing(pafs.FSSpecHandler):
        def get_file_info_selector(self, selector):
            hostile = [pafs.FileInfo(f"{there}/{name}", pafs.FileType.File, size=1, mtime=1) for name in names]
            return super().get_file_info_selector(selector) + hostile

    system = pafs.PyFileSystem(Listing(LocalFileSystem()))
    monkeypatch.setattr(remote, "_connect", lambda url: (system, str(there)))
    store = machine("b")
    assert files(store.path).keys() == {TABLE, "store.json", ".writing"}
    assert not list(tmp_path.rglob("out")) and not list(tmp_path.rglob(".hidden"))


def test_a_link_in_the_mirror_is_not_followed(machine, there, tmp_path):
    load(machine("a"), "boxes")
    store = machine("a")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine.txt").write_text("mine")
    (store.path / "runs").symlink_to(tmp_path / "elsewhere")
    with store.sending("runs/"):
        pass
    assert "runs/mine.txt" not in files(there)


def test_unreachable_places_and_keys_in_the_url_are_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path))
    with pytest.raises(InputError, match="keep keys out of the URL"):
        Store("s3://key:secret@bucket/store")
    code, _, err = run("runs", "list", "--store", "nonsense://x/y")
    assert code == 1 and err.count("\n") == 1 and "cannot reach nonsense://x/y" in err


def test_messages_name_the_url_and_not_the_mirror(there, tmp_path, monkeypatch):
    monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path / "cache"))
    code, _, err = run("generate", "--store", there.as_uri())
    assert code == 1 and f"--store {there.as_uri()}' first" in err and "cache" not in err
