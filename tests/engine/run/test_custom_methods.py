"""Methods of somebody's own: found, run, resumed, refused in a line; the examples of the docs work."""

import json

import pytest
from environment import DOCS
from fake_server import FakeServer, images, sound, texts
from processes import run

from jrdb_avr.engine.run.methods import is_custom, load_custom_method
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.schema.errors import InputError

EXAMPLES = DOCS / "examples"


def test_the_blind_example_answers_every_question_and_shows_nothing(store):
    method = f"{EXAMPLES / 'blind.py'}:Blind"
    code, out, err = run("evaluate", "--store", store.path, "--method", method, "--model", "none", "--json")
    assert code == 0, err
    row = json.loads(out)[0]
    assert (row["run_id"], row["answered"], row["error"], row["model_calls"]) == ("blind-Blind-none", row["n"], 0, 0)
    manifest = read_run_manifest(store, "blind-Blind-none")
    assert (manifest.method, manifest.model) == ("blind", "none")
    assert manifest.settings["method"]["settings"]["guesses"].startswith("first choice")
    answers = store.sql("SELECT count(answer) AS n FROM predictions").to_pylist()
    assert answers == [{"n": row["n"]}]


def test_the_glance_example_looks_once_and_asks_once(store):
    def reply(request, number):
        assert "Crop: " in texts(request) and len(images(request)) == 1
        frame = json.loads(texts(request).partition("Crop: ")[2].splitlines()[0])["frame_id"]
        return json.dumps({"answer": 1, "evidence_bboxes": [{"frame_id": frame, "bbox": [100, 200, 300, 800]}]})

    method = f"{EXAMPLES / 'glance.py'}:Glance"
    with FakeServer(sound(reply)) as server:
        ask = ("evaluate", "--store", store.path, "--method", method, "--model", "m", "--base-url", server.url)
        code, out, err = run(*ask, "--json")
    assert code == 0, err
    row = json.loads(out)[0]
    assert (row["model_calls"], row["observations"], row["error"]) == (row["n"], row["n"], 0)
    kinds = store.sql("SELECT kind, count(*) AS n FROM steps GROUP BY kind ORDER BY kind").to_pylist()
    assert kinds == [{"kind": kind, "n": row["n"]} for kind in ("model", "observe", "solve")]


MINE = """
from jrdb_avr.schema.method import Prediction
class Mine:
    name = 'mine'
    def __init__(self, chat): assert chat is None
    def settings(self): return {'n': 1}
    def answer(self, task): return Prediction('invalid', reason='no idea')
"""


def test_a_run_is_resumed_under_equal_settings_only(store, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    ask = ("evaluate", "--store", store.path, "--method", f"{file}:Mine", "--model", "none")
    assert run(*ask)[0] == 0
    assert run(*ask, "--resume")[0] == 0
    file.write_text(MINE.replace("'n': 1", "'n': 20"))
    code, _, err = run(*ask, "--resume")
    assert code == 1
    assert "settings" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "settings", "fault"),
    [
        ("'m' * 200", "nested(20)", ""),
        ("'m' * 201", "{}", "more than 200 characters"),
        ("'m'", "{'a': 'x' * 70_000}", "more than 64 KB"),
        (r"'m\ud800'", "{}", "surrogates not allowed; change it"),
        ("'m'", "{1: 2}", "str keys"),
        ("'m'", "{'a': object()}", "object is unsupported"),
        ("'m'", "nested(21)", "nested too deeply"),
        ("'m'", "nested(900)", "nested too deeply"),
        ("'m'", "nested(100_000)", "nested too deeply"),
    ],
)
def test_a_name_or_settings_that_would_spoil_tables_are_refused(store, tmp_path, name, settings, fault):
    file = tmp_path / "mine.py"
    nested = "\n\ndef nested(n):\n    v = {}\n    for _ in range(n - 1):\n        v = {'a': v}\n    return v\n"
    file.write_text(MINE.replace("'mine'", name).replace("{'n': 1}", settings) + nested)
    code, _, err = run("evaluate", "--store", store.path, "--method", f"{file}:Mine", "--model", "none")
    assert (code == 0) == (not fault) and fault in err
    if fault:
        assert err.splitlines()[-1].startswith("jrdb-avr: run 'mine-") and not list(store.path.glob("runs/*/run.json"))


BAD = {
    "nowhere.py:X": "no such file",
    "json:X": "json has no function or class X",
    "no_such_module_at_all:X": "cannot import",
    "json:loads": "cannot be made",
    "json:JSONEncoder": "cannot be made",
    "builtins:repr": "does not return a method",
    "{tmp}/broken.py:X": "SyntaxError",
    "{tmp}/raises.py:X": "RuntimeError: not today",
    "{tmp}/ends.py:X": "SystemExit: 0",
    "{tmp}/makes.py:X": "cannot be made .SystemExit",
}


@pytest.mark.parametrize("spec", BAD)
def test_what_is_no_method_is_refused_in_a_line(spec, tmp_path):
    (tmp_path / "broken.py").write_text("class X(:")
    (tmp_path / "ends.py").write_text("raise SystemExit(0)")
    (tmp_path / "makes.py").write_text("def X(chat): raise SystemExit")
    (tmp_path / "raises.py").write_text("raise RuntimeError('not today')")
    with pytest.raises(InputError, match=BAD[spec]) as error:
        load_custom_method(spec.format(tmp=tmp_path), None)
    assert "\n" not in str(error.value)


def test_names_of_ones_own_are_told_from_the_built_in_ones():
    assert is_custom("a.py:B") and is_custom("package.module:make")
    assert not is_custom("react") and not is_custom("a.py") and not is_custom("a.py:1")


def test_options_that_contradict_are_a_usage_error(store):
    for method, model in (("react", "none"), ("reacts", "simulated"), ("a.py:", "none")):
        code, _, err = run("evaluate", "--store", store.path, "--method", method, "--model", model)
        assert (code, "Traceback" in err) == (2, False)
    ask = ("--method", "react", "--model", "m", "--base-url", "http://localhost:1/v1", "--simulate", "wrong_box=0")
    assert run("evaluate", "--store", store.path, *ask)[0] == 2, "given at all, whatever its value"


def test_only_evaluate_does_without_a_model(store):
    assert run("preflight", "--model", "none")[0] == 2
    assert run("calibrate", "--store", store.path, "--model", "none")[0] == 2
