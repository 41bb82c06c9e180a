"""Questions of another program go through every step, and a wrong line is refused with its number."""

import json
import shutil
from urllib.parse import parse_qs

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from processes import run

from jrdb_avr.engine.local_server import Request
from jrdb_avr.engine.pages.view import Viewer, address
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.report.truth import is_imported
from jrdb_avr.engine.validate.references import read_references
from jrdb_avr.queries.opaque import stored_ids
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.tables import QUESTIONS

METHOD = """
import json, pathlib
from jrdb_avr.schema.answers import Choice, Evidence, FrameAnswer
from jrdb_avr.schema.method import Prediction
LINES = {line["question_id"]: line for line in map(json.loads, pathlib.Path(FILE).read_text().splitlines())}
class Scripted:
    name = "scripted"
    def __init__(self, chat): pass
    def settings(self): return {}
    def answer(self, task):
        line = LINES[task.question.question_id]
        assert task.question.question == line["question"]
        seen = line["evidence"][-1] if line["difficulty"] == "easy" else {"frame": 9000, "box": [0, 0, 9, 9]}
        answer = Choice(1) if task.question.choices else FrameAnswer(seen["frame"])
        return Prediction("answered", answer=answer, evidence=Evidence(seen["frame"], tuple(seen["box"])))
"""


@pytest.fixture
def empty(small_demo, tmp_path):
    """The store of the demo without its questions and runs. Its panoramas stay with the demo."""
    source = small_demo.folder / "store"
    shutil.copytree(source, tmp_path / "store", ignore=shutil.ignore_patterns("questions", "runs"))
    manifest = tmp_path / "store" / "store.json"
    found = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(found | {"image_root": str((source / found["image_root"]).resolve())}))
    return Store(tmp_path / "store")


def lines_of(store):
    """20 questions that another program might write: every other one asks for a frame, in words of its own."""
    rows = store.sql(
        "SELECT sequence, track, list({'frame': frame, 'box': [x, y, w, h]} ORDER BY frame)[:3] AS evidence "
        "FROM intervals_sightings JOIN intervals_frames f USING (sequence, frame) WHERE f.image "
        "GROUP BY ALL HAVING count(*) > 1 ORDER BY sequence, track LIMIT 20"
    ).to_pylist()
    assert len(rows) == 20
    for index, row in enumerate(rows):
        line = {"question_id": f"mine-{index}", "sequence": row["sequence"], "evidence": row["evidence"]}
        line |= {"family": f"lab {index % 3}", "difficulty": "easy" if index < 10 else "hard", "votes": index % 2}
        if index % 2:
            line |= {"question": "Pick the first picture of them!", "answer_mode": "frame"}
            yield line | {"answer": {"frame": row["evidence"][-1]["frame"]}, "template": "first"}
        else:
            choices = ["yes", "no"] if index % 4 else ["red", "blue", "green", "none of these"]
            yield (
                line
                | {"question": "Is it so?", "answer_mode": "multiple_choice", "choices": choices}
                | {
                    "answer": {"choice": 1},
                    "template": "poll",
                }
            )


def write(path, lines):
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def done(*arguments):
    code, out, err = run(*arguments)
    assert code == 0, err
    return out, err


def test_questions_of_another_program_go_through_every_step(empty, tmp_path):
    lines = list(lines_of(empty))
    file = write(tmp_path / "mine.jsonl", lines)
    method = tmp_path / "scripted.py"
    method.write_text(METHOD.replace("FILE", repr(str(file))))
    at = ("--store", empty.path)
    first = write(tmp_path / "first.jsonl", lines[:1])
    assert "questions imported: 1;" in done("import-questions", first, *at)[1]
    assert "questions imported: 20;" in done("import-questions", file, *at)[1]
    assert "no answer was derived again" in done("validate", *at)[1]
    for name in ("r", "r2"):
        done("evaluate", *at, "--method", f"{method}:Scripted", "--model", "none", "--run-id", name)
    (row, _) = json.loads(done("score", *at, "--json")[0])
    assert (row["n"], row["answer"], row["evidence"], row["combined"]) == (20, 75.0, 50.0, 50.0)
    by = json.loads(
        done("report", *at, "r", "--table", "difficulty", "--table", "family", "--table", "votes", "--json")[0]
    )
    assert [(row["difficulty"], row["combined"]) for row in by if row["table"] == "difficulty"] == [
        ("easy", 100.0), ("hard", 0.0),
    ]  # fmt: skip
    assert {row["family"] for row in by if row["table"] == "family"} == {"lab 0", "lab 1", "lab 2"}
    assert [row["votes"] for row in by if row["table"] == "votes"] == ["0", "1"]
    done("report", *at, "--table", "all")
    assert read_references(empty) == []
    done("report", *at, "--html", tmp_path / "report.html")
    assert run("report", *at, "--table", "hops")[0] == 2
    done("runs", "diff", "r", "r2", *at)
    done("trace", "r", "mine-3", *at, "--out", tmp_path / "trace.html")
    viewer = Viewer(empty, None, report(empty))
    for page in ("", address("question", id="mine-2", run="r"), "report", address("compare", first="r", second="r2")):
        path, _, query = page.partition("?")
        assert viewer.respond(Request("GET", path, parse_qs(query), b"")).body
    done("export", "r", "--jsonl", tmp_path / "r.jsonl", *at)
    done("export", "--public", tmp_path / "public", *at)
    done("export", "--hf", tmp_path / "hf", *at)
    card = (tmp_path / "hf" / "public" / "README.md").read_text()
    assert "Another program wrote them" in card and "difficulty" not in card and "proven answer" not in card
    before = empty.questions("answers")
    done("import-questions", tmp_path / "hf" / "public", tmp_path / "hf" / "private", *at)
    again = empty.questions("answers")
    assert sorted(again["difficulty"].to_pylist()) == sorted(before["difficulty"].to_pylist())
    assert again.schema.metadata[b"generation"] == before.schema.metadata[b"generation"]
    done("validate", *at)
    for command in ("generate", "stats", "inspect"):
        code, _, err = run(command, *at, *(["--sample", 3] if command == "inspect" else []))
        assert code == 1 and "imported questions, which have no plans" in err, command


def test_generated_questions_come_back_with_their_plans_and_are_never_mixed(small_demo, empty, tmp_path):
    source = Store(small_demo.folder / "store")
    done("export", "--hf", tmp_path / "hf", "--store", source.path)
    done("import-questions", tmp_path / "hf", "--store", empty.path)
    assert not is_imported(empty) and empty.questions("answers").equals(source.questions("answers"))
    assert empty.questions("questions").equals(source.questions("questions"))
    assert stored_ids(empty) == stored_ids(source)
    done("validate", "--store", empty.path)
    file = write(tmp_path / "mine.jsonl", lines_of(empty))
    code, _, err = run("import-questions", file, "--store", empty.path)
    assert code == 1 and "has generated questions: load the annotations into another store" in err


def test_parquet_gives_the_same_questions_as_lines(empty, tmp_path):
    lines = list(lines_of(empty))
    done("import-questions", write(tmp_path / "mine.jsonl", lines), "--store", empty.path)
    before = [empty.questions(name) for name in QUESTIONS if name != "reviews"]
    for line in lines:
        line |= {"choices": line.get("choices"), "evidence": json.dumps(line["evidence"])}
    pq.write_table(pa.Table.from_pylist(lines), tmp_path / "m.parquet")
    done("import-questions", tmp_path / "m.parquet", "--store", empty.path)
    assert [empty.questions(name) for name in QUESTIONS if name != "reviews"] == before


def test_whole_floats_are_read_and_boxes_of_another_form_get_a_note(empty, tmp_path):
    (line, *_) = lines_of(empty)
    x, y, w, h = line["evidence"][0]["box"]
    frame = float(line["evidence"][0]["frame"])
    line |= {"answer": {"choice": 2.0}, "evidence": [{"frame": frame, "box": [x, y, x + w, y + h]}]}
    code, _, err = run("import-questions", write(tmp_path / "mine.jsonl", [line]), "--store", empty.path)
    assert code == 0 and err.startswith("evidence: 2D boxes look like corners"), err
    assert json.loads(empty.questions("answers")["answer"][0].as_py()) == {"choice": 2}


CHANGES = {
    "half a choice": ({"answer": {"choice": 1.5}}, "a whole number, not 1.5"),
    "no answer": ({"answer": None}, "answer"),
    "choice of none": ({"answer": {"choice": 5}}, "a choice from 1 to 2"),
    "another mode": ({"answer_mode": "span"}, "choices"),
    "a third key": ({"answer": {"choice": 1, "frame": 2}}, "frame"),
    "same choices": ({"choices": ["a", "a"]}, "different texts"),
    "no box": ({"evidence": []}, "evidence"),
    "two boxes": ({"evidence": [{"frame": 0, "box": [0, 0, 9, 9]}] * 2}, "one box per frame"),
    "a late frame": ({"evidence": [{"frame": 99999, "box": [0, 0, 9, 9]}]}, "at frames below"),
    "a flat box": ({"evidence": [{"frame": 0, "box": [0, 0, 0, 9]}]}, "x, y, width and height"),
    "another sequence": ({"sequence": "sample-2"}, "is not loaded"),
    "an id as generated": ({"question_id": "0123456789abcdef"}, "16 hexadecimal digits"),
    "a taken key": ({"Plan": "x"}, "rename it"),
    "a repeated id": ({"question_id": "mine-0"}, "comes twice"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_wrong_line_is_named_and_nothing_is_written(name, empty, tmp_path):
    changed, message = CHANGES[name]
    lines = list(lines_of(empty))
    lines[2] = {key: value for key, value in (lines[2] | changed).items() if value is not None}
    file = write(tmp_path / "mine.jsonl", lines)
    code, _, err = run("import-questions", file, "--store", empty.path)
    assert code == 1 and f"{file}, line 3: " in err and message in err, err
    assert not (empty.path / "questions").exists()


def test_validate_finds_boxes_without_a_person(empty, tmp_path):
    lines = list(lines_of(empty))
    lines[4]["evidence"][0]["box"] = [0, 0, 5, 5]
    done("import-questions", write(tmp_path / "mine.jsonl", lines), "--store", empty.path)
    code, _, err = run("validate", "--store", empty.path)
    assert code == 1 and "mine-4: no annotated box is near [0.0, 0.0, 5.0, 5.0]" in err
