"""Files and folders that are written whole, and what killed writers leave beside them."""

import fcntl
import os
from pathlib import Path

import pytest

from jrdb_avr.queries.files import new_folder, write_bytes, write_once
from jrdb_avr.schema.errors import InputError, StoreError


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_a_killed_writer_left_is_taken_away_and_nothing_else(tmp_path):
    alive, dead, *others = (
        tmp_path / f".{name}.tmp"
        for name in ("a.json.alive000", "a.json.dead0000", "b.json.dead0000", "a.json.mine", "a.json.d.dead0000")
    )
    for path in (alive, dead, *others):
        path.touch()
    folder, pipe, link = (tmp_path / f".a.json.{name}.tmp" for name in ("folder00", "pipe0000", "link0000"))
    folder.mkdir()
    (folder / "part").touch()
    os.mkfifo(pipe)
    link.symlink_to(others[0])
    with alive.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        write_bytes(tmp_path / "a.json", b"new")
    kept = [alive, *others, folder, pipe, link]
    assert names(tmp_path) == sorted([*(path.name for path in kept), "a.json"])
    assert (tmp_path / "a.json").read_bytes() == b"new" and (folder / "part").exists()
    with new_folder(tmp_path / "a.json.d"):
        pass
    assert others[-1].exists()


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    place = tmp_path / "made"
    with pytest.raises(StoreError, match="cannot write"), new_folder(place) as made:
        (made / "part").write_text("half")
        raise OSError(28, "full")
    assert names(tmp_path) == []
    place.mkdir()
    with new_folder(place) as made:
        (made / "part").write_text("whole")
        assert names(place) == []
    assert names(tmp_path) == ["made"] and (place / "part").read_text() == "whole"
    with pytest.raises(InputError, match="not empty"), new_folder(place):
        pass
    with pytest.raises(StoreError, match="OSError"), new_folder(tmp_path / "other"):
        raise OSError


def test_a_file_that_cannot_be_read_is_named_beside_the_folder_that_it_was_for(tmp_path):
    with (
        pytest.raises(StoreError, match=f"cannot write {tmp_path}/made: {tmp_path}/source: "),
        new_folder(tmp_path / "made"),
    ):
        (tmp_path / "source").read_bytes()
    with (
        pytest.raises(StoreError, match=f"cannot write {tmp_path}/made: No such"),
        new_folder(tmp_path / "made") as made,
    ):
        (made / "gone").read_bytes()


def test_a_folder_that_cannot_be_replaced_is_refused_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("empty")
    with new_folder(tmp_path / "link") as made:
        (made / "part").touch()
    assert names(tmp_path / "empty") == ["part"] and (tmp_path / "link").is_symlink()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(InputError, match="name a new folder inside it"), new_folder(Path()):
        pass


def test_of_two_who_write_a_file_once_the_first_ones_stays(tmp_path):
    write_once(tmp_path / "key", b"first")
    write_once(tmp_path / "key", b"second")
    assert (tmp_path / "key").read_bytes() == b"first"
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600
    assert names(tmp_path) == ["key"]
