"""Opaque names of sequences: stable, not to be guessed, and all that a method and its errors hold."""

import dataclasses
import hashlib
import hmac
import stat

import pytest
from painted import FRAMES, QUESTIONS_ASKED, SEQUENCE, write_answers

from jrdb_avr.engine.report.comparison import diff
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.journal import Finished, with_id
from jrdb_avr.engine.run.options import EvaluateOptions, MethodOptions, QuestionSelection, RunOptions
from jrdb_avr.queries.opaque import key_path, opaque_ids, opaque_names, stored_ids
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import ObserveError, StoreError
from jrdb_avr.schema.method import Prediction


class Notes:
    """Answers 1, and notes what it was handed and what the errors said."""

    name = "notes"

    def __init__(self):
        self.texts, self.sequences, self.errors, self.ids = [], set(), [], []

    def answer(self, task):
        names = {task.question.sequence, task.sequence.sequence}
        names.add(task.observe(task.question.sequence, FRAMES[0], 180.0).sequence)
        names.add(task.panorama(task.question.sequence, FRAMES[0]).sequence)
        self.sequences |= names
        self.ids.append(task.question.question_id)
        self.texts.append(repr(dataclasses.astuple(task.question)))
        for place in ((SEQUENCE, 0), (task.question.sequence, 1), ("../x", 0)):
            try:
                task.observe(*place, 180.0)
            except ObserveError as error:
                self.errors.append(str(error))
        return Prediction("answered", Choice(1))


def play(store, method, opaque=True, limit=1, **run):
    """Evaluate a method."""
    options = EvaluateOptions(
        method=MethodOptions(opaque=opaque), selection=QuestionSelection(limit=limit), run=RunOptions(**run)
    )
    return evaluate(store, method, options=options)


def test_a_method_sees_the_opaque_name_alone(store):
    method = Notes()
    run = play(store, method, limit=3)
    assert method.sequences == {opaque_names(store, [SEQUENCE])[SEQUENCE]}
    # The name that the method itself gives comes back once.
    assert len(method.errors) == 9
    texts = [text.replace(f"no sequence {SEQUENCE!r}", "") for text in (*method.texts, *method.errors)]
    assert not [text for text in texts if SEQUENCE in text]
    assert run.predictions["question_id"].to_pylist() == sorted(q.question_id for q in QUESTIONS_ASKED[:3])


def test_the_name_is_a_keyed_hash_that_stays(store):
    first = opaque_names(store, [SEQUENCE, "other"])
    key = bytes.fromhex(key_path(store).read_text())
    assert first[SEQUENCE] == "sequence-" + hmac.new(key, SEQUENCE.encode(), hashlib.sha256).hexdigest()[:16]
    assert len(set(first.values())) == 2 and opaque_names(store, [SEQUENCE, "other"]) == first
    assert stat.S_IMODE(key_path(store).stat().st_mode) == 0o600
    key_path(store).unlink()
    assert opaque_names(store, [SEQUENCE]) != first


def test_a_method_sees_an_opaque_id_and_the_store_keeps_its_own(store):
    ids = [question.question_id for question in QUESTIONS_ASKED]
    seen = [opaque_ids(store, ids)[name] for name in ids]
    assert {len(name) for name in seen} == {16} and not set(seen) & set(ids)
    first, rest = Notes(), Notes()
    play(store, first, limit=3, run_id="one")
    run = play(store, rest, limit=5, run_id="one", resume=True)
    # A resumed run finds the questions that are answered.
    assert sorted(first.ids) == sorted(seen[:3]) and sorted(rest.ids) == sorted(seen[3:5])
    assert run.predictions["question_id"].to_pylist() == sorted(ids[:5])
    kept = b"".join(path.read_bytes() for path in store.run_path("one").rglob("*.json*"))
    assert not [name for name in seen if name.encode() in kept]
    assert dict(zip(seen, ids, strict=True)).items() <= stored_ids(store).items()


def test_an_opaque_run_is_compared_with_another(store):
    write_answers(store)
    play(store, Notes(), limit=3, run_id="opaque")
    play(store, Notes(), opaque=False, limit=5, run_id="plain")
    assert [row["n"] for row in diff(store, "opaque", "plain").rows] == [3, 3, 3]


def test_rows_of_a_world_model_get_the_id_of_the_store():
    fact = {"episode": {"key": "run/aa11", "question": "aa11"}}
    entry = Finished("aa11", {"question_id": "aa11"}, [{"question_id": "aa11"}], [fact])
    assert "aa11" not in repr(with_id(entry, "bb22")) and "run/bb22" in repr(with_id(entry, "bb22"))


def test_a_damaged_key_is_one_line(store):
    for text in ("", "xyz", "00"):
        key_path(store).write_text(text)
        with pytest.raises(StoreError, match="delete it"):
            opaque_names(store, [SEQUENCE])


def test_a_run_stays_opaque_under_one_key(store):
    play(store, Notes(), run_id="one")
    with pytest.raises(StoreError, match=r"differs in the opaque\.key"):
        play(store, Notes(), False, None, run_id="one", resume=True)
    play(store, Notes(), limit=None, run_id="one", resume=True)
    key_path(store).unlink()
    with pytest.raises(StoreError, match=r"differs in the opaque\.key"):
        play(store, Notes(), limit=None, run_id="one", resume=True)


def test_a_broken_picture_does_not_tell_the_folder(store, tmp_path):
    (tmp_path / "images" / SEQUENCE).mkdir(parents=True)
    for frame in FRAMES:
        (tmp_path / "images" / SEQUENCE / f"{frame:06d}.jpg").write_bytes(b"no picture")
    run = play(store, Notes(), images=tmp_path / "images")
    (reason,) = run.predictions["reason"].to_pylist()
    assert "is no whole JPEG" in reason and SEQUENCE not in reason
