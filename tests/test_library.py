"""The public surface: `import jrdb_avr` offers it lazily and typed, and results display in a notebook."""

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import environment
import msgspec
import pyarrow as pa
import pytest
from environment import DOCS

import jrdb_avr
from jrdb_avr.engine.generate.run import Generation
from jrdb_avr.engine.report.comparison import Scores
from jrdb_avr.engine.run.evaluate import RunResult
from jrdb_avr.engine.validate.validation import Validation
from jrdb_avr.loaders.problems import Problem
from jrdb_avr.loaders.report import SequenceReport
from jrdb_avr.loaders.result import LoadResult
from jrdb_avr.queries import display
from jrdb_avr.queries.display import step_counter
from jrdb_avr.queries.manifest import SequenceEntry
from jrdb_avr.schema import answer_modes, errors
from jrdb_avr.schema.tables import RUNS

ROOT = Path(jrdb_avr.__file__).parent
PROMISED = (
    *("Store", "load", "generate", "validate", "evaluate", "score", "report", "Observer", "Rules", "Question"),
    *("Task", "Method", "Observation", "Prediction", "Evidence"),
    *(mode.type.__name__ for mode in answer_modes.MODES.values()),
    *(name for name, value in vars(errors).items() if isinstance(value, type) and value.__module__ == errors.__name__),
)


def python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()


def test_every_promised_name_is_there_and_documented():
    assert set(PROMISED) <= set(jrdb_avr.__all__) <= set(dir(jrdb_avr))
    for name in jrdb_avr.__all__:
        value = getattr(jrdb_avr, name)
        assert value is getattr(jrdb_avr, name)
        assert name == "Answer" or (value.__name__ == name and value.__doc__), name
    with pytest.raises(AttributeError, match="no attribute 'Stores'"):
        jrdb_avr.Stores  # noqa: B018


def test_the_import_alone_loads_nothing():
    code = "import sys; before = set(sys.modules); import jrdb_avr; dir(jrdb_avr); print(*set(sys.modules) - before)"
    names = python(code)
    assert [name for name in names if name.startswith("jrdb_avr")] == ["jrdb_avr"]
    assert not {"numpy", "pyarrow", "msgspec", "duckdb", "kuzu", "cv2", "click", "rich"} & set(names)
    assert python("from jrdb_avr import *; print(Store.__name__, evaluate.__name__)") == ["Store", "evaluate"]


def test_a_system_without_file_locks_is_told_in_a_line():
    code = "import sys; sys.modules['fcntl'] = None; import jrdb_avr.engine.cli"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1) and "WSL" in done.stderr


def test_an_old_python_is_told_in_a_line():
    code = "import sys; sys.version_info, sys.version = (3, 10, 13), '3.10.13 (main)'; import jrdb_avr"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "needs Python 3.11 or newer, and this is Python 3.10.13" in done.stderr


def test_programs_get_the_names_of_the_stub():
    tree = ast.parse((ROOT / "__init__.pyi").read_text("utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert [(alias.asname, node.module) for node in imports for alias in node.names] == [*jrdb_avr._MODULES.items()]


SNIPPET = """
import jrdb_avr as avr
store = avr.Store("store")
reveal_type(avr.evaluate(store, "react", "simulated", avr.EvaluateOptions(run=avr.RunOptions(resume=True))).predictions)
reveal_type(avr.report(store).table("main"))
reveal_type(avr.load("root", store).refused)
reveal_type(avr.generate(store, avr.Rules()).faults)
reveal_type(avr.validate(store).sound)
reveal_type(avr.Observer(store)("s", 0, 180.0).left)
class Mine:
    name = "mine"
    def answer(self, task: avr.Task) -> avr.Prediction:
        return avr.Prediction("answered", avr.Choice(1), avr.Evidence(0, (0, 0, 1, 1)))
avr.evaluate(store, Mine())
avr.evaluate(store, 5)
"""


@pytest.mark.slow
def test_a_type_checker_sees_the_types(tmp_path):
    (tmp_path / "snippet.py").write_text(SNIPPET)
    # Because mypy does not follow every kind of editable install.
    (tmp_path / "jrdb_avr").symlink_to(ROOT)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", environment.ROOT / "pyproject.toml", "snippet.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    notes = [line.partition("note: Revealed type is ")[2].strip('"') for line in done.stdout.splitlines()]
    found = [note.replace("builtins.", "") for note in notes if note]
    assert found[1:] == ["list[dict[str, Any]]", "int", "tuple[str, ...]", "bool", "int"]
    (error,) = (line for line in done.stdout.splitlines() if ": error:" in line)
    assert 'incompatible type "int"; expected "str | Method"' in error


def test_the_page_of_the_api_is_what_the_code_says():
    made = subprocess.run(
        [sys.executable, "-m", "jrdb_avr.engine.commands.page", "api"],
        capture_output=True,
        check=True,
        encoding="utf-8",
    )
    assert made.stdout == (DOCS / "api.md").read_text("utf-8"), "run engine.commands.page api > docs/api.md"


# -- display ----------------------------------------------------------------------------------------------------------


def test_a_store_displays_what_it_holds(store, tmp_path):
    manifest = store.manifest()
    store.write_manifest(msgspec.structs.replace(manifest, sequences={"s": SequenceEntry(("2d", "pose"), {})}))
    assert repr(store) == f"<Store: {store.path}, 1 sequences, 13 questions, 0 runs>"
    assert "<td>2d, pose</td>" in store._repr_html_()
    assert repr(jrdb_avr.Store(tmp_path / "none")) == f"<Store: {tmp_path / 'none'}, nothing loaded>"
    assert "<table>" not in jrdb_avr.Store(tmp_path / "none")._repr_html_()
    for i, damage in enumerate(("store.json", "questions/questions.parquet")):
        damaged = jrdb_avr.Store(tmp_path / str(i))
        shutil.copytree(store.path, damaged.path)
        (damaged.path / damage).write_text("{")
        assert repr(damaged) == f"<Store: {damaged.path}, damaged>"
        assert "damaged" in damaged._repr_html_()


def prediction(status):
    row = {field.name: None if field.nullable else 0 for field in RUNS["predictions"]}
    texts = {field.name: "" for field in RUNS["predictions"] if field.type == pa.string() and not field.nullable}
    return row | texts | {"status": status, "n_model_calls": 2}


def results():
    problem = Problem("file", "is <broken>", 1, "s.json", "", "", "", "2d")
    unsound = Validation()
    unsound.check("ids", False, "0: id of other columns")
    rows = [prediction("answered"), prediction("error")]
    template = {"family": "f", "template": "t", "candidates": 3, "reached": 2}
    return {
        "1 answered, 0 invalid, 1 error": RunResult("r", pa.Table.from_pylist(rows, RUNS["predictions"]), True),
        "1 refused": LoadResult([SequenceReport("s", [problem], layers=["2d"])]),
        "sound, 0 checks": Validation(),
        "1 faults": unsound,
        "2 questions of 1 templates": Generation((template,), (template,), ()),
        "1 runs": Scores([{"run": "a<b", "answer": 12.5, "evidence": None}]),
    }


@pytest.mark.parametrize("text", results())
def test_results_display_as_a_line_and_as_tables(text):
    result = results()[text]
    line = repr(result)
    assert line.startswith(f"<{type(result).__name__}: ") and text in line and "\n" not in line
    html = result._repr_html_()
    assert html.count("<table>") == html.count("</table>") >= 1
    assert "<broken>" not in html and "a<b" not in html


def test_long_tables_are_cut_and_say_so():
    found = Scores([{"run": str(n), "share": 1 / 3} for n in range(display.MAX_ROWS + 1)])._repr_html_()
    assert found.count("<tr>") == display.MAX_ROWS + 1
    assert f"({display.MAX_ROWS} of {display.MAX_ROWS + 1} rows)" in found and "<td>0.333333</td>" in found


def test_progress_is_called_with_steps_done_and_all():
    seen = []
    advance = step_counter(lambda *event: seen.append(event), "counting", 3)
    advance()
    advance(2)
    assert seen == [("counting", 0, 3), ("counting", 1, 3), ("counting", 3, 3)]
    step_counter(None, "silent", 1)(1)


def test_a_method_object_is_evaluated(store):
    """The library takes a method itself, and a path in place of a store."""

    class Mine:
        name = "mine"

        def answer(self, task):
            return jrdb_avr.Prediction("answered", jrdb_avr.Choice(1))

    seen = []
    with pytest.warns(jrdb_avr.AvrWarning, match="questions are left out") as warned:
        run = jrdb_avr.evaluate(store.path, Mine(), progress=lambda *event: seen.append(event))
    assert warned[0].filename == __file__
    assert run.run_id == "mine-none" and run.row()["answered"] == run.predictions.num_rows == 12
    assert seen[0] == ("mine, none", 0, 12) and seen[-1] == ("mine, none", 12, 12)
    with pytest.raises(jrdb_avr.InputError, match="not one of"):
        jrdb_avr.evaluate(store, "reacts", "simulated")
    with pytest.raises(jrdb_avr.InputError, match="needs a model"):
        jrdb_avr.evaluate(store, "react")
