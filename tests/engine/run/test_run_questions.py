"""Which questions a run answers: chosen among those that can be asked, and more of them later."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from painted import QUESTIONS_ASKED, SEQUENCE, question, write_public
from processes import run

from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.overview import list_runs
from jrdb_avr.engine.run.selection import matching, select_questions
from jrdb_avr.queries.questions import QuestionRow
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError

WORDS = [
    QuestionRow(f"{n:016x}", sequence, family, template, f"{n}?", (), "number")
    for n, (sequence, family, template) in enumerate(
        (s, f, t)
        for t in ("gap", "span")
        for f in ("long_range", "chain_2hop")
        for s in ("a", "b", "c")
        for _ in range(3)
    )
]


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Panoramas of the sequences a and b, none of c."""
    root = tmp_path_factory.mktemp("images")
    for name in "ab":
        (root / name).mkdir()
        (root / name / "000000.jpg").touch()
    return str(root)


@given(
    st.fixed_dictionaries(
        {
            "families": st.sampled_from([(), ("long_range",), ("long_range", "chain_2hop")]),
            "templates": st.sampled_from([(), ("gap",)]),
            "sequences": st.sampled_from([(), ("a",), ("a", "c")]),
            "per_template": st.none() | st.integers(1, 9),
            "limit": st.none() | st.integers(1, 20),
            "seed": st.none() | st.integers(0, 3),
        }
    ),
    st.data(),
)
def test_a_selection_takes_what_can_be_asked_and_a_larger_one_keeps_it(images, wanted, data):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *args, **named: None)
        found = select_questions(WORDS, QuestionSelection(**wanted), images)
        names = {"families": "family", "templates": "template", "sequences": "sequence"}
        able = [
            own
            for own in WORDS
            if own.sequence != "c" and all(not wanted[k] or getattr(own, c) in wanted[k] for k, c in names.items())
        ]
        most = wanted["per_template"] or len(WORDS)
        by_template = [sum(own.template == name for own in able) for name in ("gap", "span")]
        assert len(found) == len(set(found)) == min(sum(min(n, most) for n in by_template), wanted["limit"] or 99)
        assert set(found) <= set(able)
        if wanted["seed"] is None and wanted["per_template"] is None:
            assert found == able[: wanted["limit"]]
        if wanted["per_template"] is not None:
            # As many of each template, unless there are no more of one.
            taken = [sum(own.template == name for own in found) for name in ("gap", "span")]
            assert all(
                max(taken) - n <= 1 or n == min(there, most) for n, there in zip(taken, by_template, strict=True)
            )
        field = data.draw(st.sampled_from(["per_template", "limit"]))
        if wanted[field]:
            larger = select_questions(WORDS, QuestionSelection(**{**wanted, field: wanted[field] + 1}), images)
            assert set(found) <= set(larger)


def test_the_seed_draws(images):
    drawn = {
        tuple(select_questions(WORDS[:18:3], QuestionSelection(limit=2, seed=seed, sequences=("a", "b")), images))
        for seed in range(9)
    }
    assert len(drawn) > 3


def test_unknown_names_are_refused_with_the_nearest():
    for field, name, near in (
        ("templates", "spam", "span"),
        ("families", "long_rang", "long_range"),
        ("sequences", "d", "a, b, c"),
    ):
        with pytest.raises(InputError, match=near):
            matching(WORDS, QuestionSelection(**{field: (name,)}))
    with pytest.raises(InputError, match="1 of 2 questions 'nope' is not in the store"):
        matching(WORDS, QuestionSelection(questions=(WORDS[0].question_id, "nope")))
    with pytest.raises(InputError, match="no question is named"):
        QuestionSelection.of([])
    twice = [WORDS[4].question_id, WORDS[1].question_id] * 2
    assert matching(WORDS, QuestionSelection.of(twice)) == [WORDS[4], WORDS[1]]


def test_what_cannot_be_asked_is_counted(images):
    left_out = "12 of 36 questions are left out: 1 sequences have no panoramas .c.; 24 can be"
    with pytest.warns(AvrWarning, match=left_out):
        select_questions(WORDS, QuestionSelection(limit=1), images)
    with pytest.raises(StoreError, match="no selected question can be asked"):
        select_questions(WORDS, QuestionSelection(sequences=("c",)), images)
    with pytest.raises(StoreError, match="select by fewer options"):
        select_questions(WORDS[:9], QuestionSelection(sequences=("a",), questions=(WORDS[5].question_id,)), images)


def test_a_shard_needs_all_its_panoramas_and_no_others(images):
    shards = [select_questions(WORDS, QuestionSelection(shard=(n, 3), limit=9), images) for n in (1, 2)]
    assert [[row.sequence for row in rows] for rows in shards] == [["a"] * 3, ["b"] * 3]
    with pytest.raises(StoreError, match="sequence c of this shard has no panoramas"):
        select_questions(WORDS, QuestionSelection(shard=(3, 3), limit=9), images)


METHOD = """
from jrdb_avr.schema.method import Prediction
class Mine:
    name = 'mine'
    def __init__(self, chat): pass
    def answer(self, task):
        with open(__file__ + '.log', 'a') as log: log.write(task.question.question_id + '\\n')
        return self.deeper(task)
    def deeper(self, task):
        return Prediction('invalid', reason='no idea')
"""


@pytest.fixture
def evaluate(store, tmp_path):
    """Run a method of a user's own; returns (exit code, row, stderr), and the ids that it was called with."""
    file = tmp_path / "mine.py"
    file.write_text(METHOD)

    def call(*options):
        log = tmp_path / "mine.py.log"
        log.write_text("")
        ask = f"evaluate --store {store.path} --method {file}:Mine --model none --run-id r --json".split()
        code, out, err = run(*ask, *options)
        return code, json.loads(out) if out else None, err, log.read_text().split()

    return call


def test_the_limit_counts_what_can_be_asked(store, evaluate):
    blind = [question(t, t + 60, "unseen") for t in range(0, 90, 15)]
    write_public(store, [*blind, *QUESTIONS_ASKED], {SEQUENCE: range(0, 301, 15), "unseen": [0]})
    code, (row,), err, asked = evaluate("--limit", "5")
    assert (code, row["n"]) == (0, 5)
    assert "6 of 18 questions are left out: 1 sequences have no panoramas (unseen); 12 can be asked" in err
    assert sorted(asked) == sorted(own.question_id for own in QUESTIONS_ASKED[:5])


def test_a_run_grows_and_keeps_what_is_there(store, evaluate):
    assert evaluate("--per-template", "3", "--seed", "1")[0] == 0
    first = read_run_manifest(store, "r")
    assert first.selection == {"per_template": 3, "seed": 1}
    assert "--resume to finish or enlarge it" in evaluate("--limit", "8")[2]
    code, (row,), _, asked = evaluate("--per-template", "8", "--seed", "1", "--resume")
    assert (code, row["n"], len(asked)) == (0, 8, 5)
    grown = read_run_manifest(store, "r")
    assert set(first.question_ids) < set(grown.question_ids) and not set(asked) & set(first.question_ids)
    assert (grown.selection, grown.created) == ({"per_template": 8, "seed": 1}, first.created)
    rows = store.sql("SELECT question_id FROM predictions")["question_id"].to_pylist()
    assert sorted(rows) == sorted(grown.question_ids)
    # Without a selection it is finished as it is, also where its panoramas are gone.
    assert evaluate("--resume", "--images", store.path)[1][0]["n"] == 8
    assert "5 questions that this selection leaves out" in evaluate("--limit", "3", "--seed", "1", "--resume")[2]


def test_a_run_that_grows_is_unfinished_until_it_is_answered(store, evaluate, tmp_path):
    evaluate("--limit", "2")
    file = tmp_path / "mine.py"
    # Ctrl-C, while the method looks again and again.
    stop = "__import__('signal').pthread_kill(__import__('threading').main_thread().ident, 2)"
    endless = f"{stop}\n        for _ in range(10**7): task.record(None)"
    file.write_text(METHOD.replace("return self.deeper(task)", endless))
    assert evaluate("--resume", "--limit", "4", "--concurrency", "1")[0] == 130
    assert [(row["state"], row["n"], row["invalid"]) for row in list_runs(store)] == [("unfinished", 4, 2)]
    file.write_text(METHOD)
    code, (row,), _, asked = evaluate("--resume")
    assert (code, row["n"], len(asked)) == (0, 4, 2)


@pytest.mark.parametrize("error", ["SystemExit(0)", "KeyboardInterrupt"])
def test_a_method_that_would_end_the_program_ends_its_question(evaluate, tmp_path, error):
    (tmp_path / "mine.py").write_text(METHOD.replace("return self.deeper(task)", f"raise {error}"))
    code, (row,), err, asked = evaluate("--limit", "3")
    assert (code, row["n"], row["error"], len(asked)) == (1, 3, 3, 3)
    assert f"3 of them because: {error.partition('(')[0]}" in err and "(mine.py:8, in answer)" in err


def test_an_exception_of_a_method_is_shown_with_its_place(store, evaluate, tmp_path):
    lines = METHOD.replace("return Prediction(", "return {}['who'] or Prediction(")
    (tmp_path / "mine.py").write_text(lines)
    code, _, err, _ = evaluate("--limit", "3")
    at = next(n for n, line in enumerate(lines.splitlines(), 1) if "who" in line)
    last = err.splitlines()[-1]
    assert code == 1 and last.startswith(
        f"3 of 3 questions ended in an error, 3 of them because: KeyError: 'who' (mine.py:{at}, in deeper); run the "
    )
    # In a library the method's own line is named, and of an error of this package likewise.
    for raising, text in (("__import__('json').loads('{')", "JSONDecodeError"), ("task.observe('x', 1, 2)", "")):
        (tmp_path / "mine.py").write_text(METHOD.replace("return self.deeper(task)", raising))
        err = evaluate("--resume")[2]
        assert f"because: {text}" in err and "(mine.py:8, in answer)" in err
