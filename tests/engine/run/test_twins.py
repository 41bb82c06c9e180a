"""Time twins in runs: no method comes to know them, and each question is asked in a conversation of its own."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from fake_server import recorded_server
from painted import QUESTIONS_ASKED, asked_sight, write_answers
from sources import ROOT

from jrdb_avr.engine.commands.evaluate import command
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.public import export_public
from jrdb_avr.schema.answers import Choice, Evidence
from jrdb_avr.schema.errors import AvrWarning
from jrdb_avr.schema.method import Prediction
from jrdb_avr.schema.tables import QUESTIONS

KEY = "the-key-of-twins"
TWINS = QUESTIONS_ASKED[:2]
"""Two questions with the same description and choices, about two times."""


@pytest.fixture
def twins(store):
    """A store with answers in which the first two questions are twins."""
    write_answers(store, QUESTIONS_ASKED)
    answers = store.questions("answers")
    keys = [KEY if own in [q.question_id for q in TWINS] else None for own in answers["question_id"].to_pylist()]
    column = answers.schema.get_field_index("twin_id")
    answers = answers.set_column(column, QUESTIONS["answers"].field("twin_id"), pa.array(keys, pa.string()))
    store.write_questions("answers", answers, {})
    return store


@pytest.mark.parametrize("method", ["monolithic", "chain-of-thought", "search-recognize", "react", "agent"])
def test_every_request_asks_one_question(twins, method, tmp_path):
    texts = [own.question for own in TWINS]
    with recorded_server(asked_sight()) as (url, sent):
        options = ["--store", str(twins.path), "--method", method, "--model", "simulated:perfect", "--base-url", url]
        names = ",".join(own.question_id for own in TWINS)
        result = CliRunner().invoke(command, [*options, "--questions", names, "--concurrency", "1"])
    assert result.exception is None, result.output
    asked = [[text in bytes(body).decode() for text in texts] for body in sent]
    assert sum(map(any, asked)) > 1 and {tuple(own) for own in asked if any(own)} == {(True, False), (False, True)}


class Spy:
    """A method that writes down all that it is given."""

    name = "spy"

    def __init__(self):
        self.seen = []

    def answer(self, task):
        frame = task.sequence.frames[0]
        looks = [task.observe(task.sequence.sequence, frame, 180.0), task.panorama(task.sequence.sequence, frame)]
        self.seen.append(
            repr([task.question, task.sequence, *[vars(look) for look in looks if hasattr(look, "__dict__")]])
        )
        return Prediction("answered", Choice(1), Evidence(frame, (1.0, 1.0, 9.0, 9.0)))


def test_a_method_is_given_no_key(twins):
    spy = Spy()
    evaluate(twins, spy)
    assert len(spy.seen) == len(QUESTIONS_ASKED) and not any(KEY in seen for seen in spy.seen)
    files = [path for path in (twins.path / "runs").rglob("*") if path.is_file()]
    assert files and not any(KEY in text_of(path) for path in files)


def text_of(path):
    """All that a file holds, as text."""
    return str(pq.read_table(path).to_pydict()) if path.suffix == ".parquet" else path.read_bytes().decode("latin-1")


def test_a_public_store_holds_no_key(twins, tmp_path):
    with pytest.warns(AvrWarning, match="1 of 2 sequences have no panorama"):
        export_public(twins, tmp_path / "public")
    held = [
        any(KEY in text_of(path) for path in folder.rglob("*") if path.is_file())
        for folder in (tmp_path / "public", twins.path / "questions")
    ]
    assert held == [False, True]


def test_only_what_makes_scores_and_shows_questions_names_the_column():
    """Methods, runs, servers and the worker protocol have no access to the key of twins."""
    rooms = ("agent", "engine/run", "engine/integrations", "engine/observe", "queries", "loaders")
    files = [path for room in rooms for path in (ROOT / room).rglob("*") if path.suffix in (".py", ".md", ".sql")]
    assert len(files) > 100
    assert [path for path in files if "twin_id" in path.read_text("utf-8")] == []
