"""Files and folders that are written whole, and what killed writers leave beside them."""

import fcntl

import pytest

from jrdb_avr.queries.files import new_folder, write_bytes, write_once
from jrdb_avr.schema.errors import InputError, StoreError


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_a_killed_writer_left_is_taken_away_and_nothing_else(tmp_path):
    alive, dead, other = (tmp_path / f".{name}.tmp" for name in ("a.json.alive", "a.json.dead", "b.json.dead"))
    for path in (alive, dead, other):
        path.touch()
    (tmp_path / ".a.json.folder.tmp").mkdir()
    (tmp_path / ".a.json.folder.tmp/part").touch()
    with alive.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        write_bytes(tmp_path / "a.json", b"new")
    assert names(tmp_path) == sorted([alive.name, other.name, "a.json"])
    assert (tmp_path / "a.json").read_bytes() == b"new"


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


def test_of_two_who_write_a_file_once_the_first_ones_stays(tmp_path):
    write_once(tmp_path / "key", b"first")
    write_once(tmp_path / "key", b"second")
    assert (tmp_path / "key").read_bytes() == b"first"
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600
    assert names(tmp_path) == ["key"]
