"""What reviewers decide: imported, compared, and left out of the next generation."""

import json
import os
import random
from functools import cache

import duckdb
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from keyframe_layers import layers_in_memory
from loaded_stores import graphless_store
from processes import run
from random_worlds import lively_world

from jrdb_avr.engine.generate import run as generation
from jrdb_avr.engine.pages.reviews import read_reviews, rejected
from jrdb_avr.queries.runs import questions_hash
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.queries.store import Store


def decisions(store, path, given, sha=None):
    """given: {question id: (decision, reason)}."""
    rows = [{"question_id": name, "decision": what, "reason": why} for name, (what, why) in given.items()]
    path.write_text(json.dumps({"questions_sha256": sha or questions_hash(store), "decisions": rows}))
    return path


@pytest.fixture
def store(benchmark_copy):
    return benchmark_copy


def ids(store):
    return store.questions("questions")["question_id"].to_pylist()


def test_decisions_are_stored_and_the_latest_counts(store, tmp_path):
    first, second, third = ids(store)[:3]
    file = decisions(store, tmp_path / "d.json", {first: ("accept", ""), second: ("reject", "two people fit")})
    code, out, err = run("inspect", "--import", file, "--reviewer", "ada", "--store", store.path)
    assert (code, out) == (0, "")
    assert "2 decisions of ada stored; 2 reviews in all" in err
    assert rejected(store) == {second}
    file = decisions(store, tmp_path / "d.json", {second: ("accept", ""), third: ("reject", "x")})
    assert run("inspect", "--import", file, "--reviewer", "ada", "--store", store.path)[0] == 0
    assert [(row["question_id"], row["decision"]) for row in read_reviews(store)] == sorted(
        [(first, "accept"), (second, "accept"), (third, "reject")]
    )
    file = decisions(store, tmp_path / "d.json", {first: ("accept", ""), second: ("reject", ""), third: ("reject", "")})
    code, out, _ = run("inspect", "--import", file, "--reviewer", "grace", "--store", store.path, "--json")
    assert json.loads(out) == [{"first": "ada", "second": "grace", "n": 3, "agree": 2, "kappa": pytest.approx(0.4)}]


BAD = {
    "no JSON": "{",
    "another form": '{"decisions": []}',
    "another key": '{"questions_sha256": "SHA", "decisions": [], "x": 1}',
    "no decision": '{"questions_sha256": "SHA", "decisions": [{"question_id": "0123456789abcdef"}]}',
    "another word": '{"questions_sha256": "SHA", "decisions": [{"question_id": "0123456789abcdef", "decision": "ok"}]}',
    "no id": '{"questions_sha256": "SHA", "decisions": [{"question_id": "../x", "decision": "accept"}]}',
    "an unknown question": '{"questions_sha256": "SHA", "decisions": [{"question_id": "0000000000000000", '
    '"decision": "accept"}]}',
    "decided twice": '{"questions_sha256": "SHA", "decisions": [{"question_id": "KNOWN", "decision": "accept"}, '
    '{"question_id": "KNOWN", "decision": "reject"}]}',
    "nested too deep": "[" * 100_000,
    "other questions": '{"questions_sha256": "0", "decisions": []}',
    "no text": "\ud800",
}


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_cannot_be_used_is_refused_in_a_line(sample_benchmark, tmp_path, name):
    store, file = sample_benchmark, tmp_path / "d.json"
    text = BAD[name].replace("SHA", questions_hash(store)).replace("KNOWN", ids(store)[0])
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    code, out, err = run("inspect", "--import", file, "--reviewer", "ada", "--store", store.path)
    assert (code, out) == (1, "")
    assert err.startswith("jrdb-avr: ") and err.count("\n") == 1 and "d.json" in err
    assert not store.question_path("reviews").exists()


@pytest.mark.parametrize("make", [os.mkfifo, lambda place: place.symlink_to("/dev/zero")])
def test_what_is_no_plain_file_is_refused_and_never_waited_for(sample_benchmark, tmp_path, make):
    make(tmp_path / "d.json")
    code, out, err = run(
        "inspect", "--import", tmp_path / "d.json", "--reviewer", "a", "--store", sample_benchmark.path
    )
    assert (code, out, err.count("\n")) == (1, "", 1) and "d.json" in err
    assert run("inspect", "--import", "/dev/zero", "--reviewer", "a", "--store", sample_benchmark.path)[0] == 1


def test_options_go_together(sample_benchmark, tmp_path):
    store = sample_benchmark
    for options in (["--import", "x"], ["--reviewer", "ada"], [], ["--import", "x", "--reviewer", "a", "0" * 16]):
        assert run("inspect", *options, "--store", store.path)[0] == 2
    assert run("inspect", "--import", tmp_path / "none", "--reviewer", "ada", "--store", store.path)[0] == 1
    assert run("inspect", "--import", "x", "--reviewer", "\n", "--store", store.path)[0] == 2
    assert run("inspect", "--import", "x", "--reviewer", "a\u202eda", "--store", store.path)[0] == 2


@pytest.fixture
def in_memory():
    with layers_in_memory():
        yield


@pytest.mark.slow
def test_generate_leaves_out_what_was_rejected(tmp_path, monkeypatch, in_memory):
    # What is found does not depend on the reviews, so it is searched for once.
    monkeypatch.setattr(generation, "search_sequence", cache(generation.search_sequence))
    worlds = [lively_world(random.Random(seed), f"yard-2020-01-0{seed}_0") for seed in (5, 8)]
    store = graphless_store(tmp_path, worlds[0] | worlds[1])
    assert run("generate", "--store", store.path, "--workers", 1)[0] == 0
    before = ids(store)
    assert len(before) > 30
    gone = before[:2]
    file = decisions(store, tmp_path / "d.json", dict.fromkeys(gone, ("reject", "no")))
    assert run("inspect", "--import", file, "--reviewer", "ada", "--store", store.path)[0] == 0
    # Twice: the second time the rejected ones are no longer among the questions.
    for _ in range(2):
        assert run("generate", "--store", store.path, "--workers", 1, "--exclude-rejected")[0] == 0
        after = ids(store)
        assert not set(gone) & set(after)
        assert len(set(before) - set(after)) < len(before) / 3


# -- agreement --------------------------------------------------------------------------------------------------------


def agreements(reviews):
    """The rows of the statement over (reviewer, question, decision)."""
    columns = zip(*reviews, strict=True) if reviews else ((), (), ())
    with duckdb.connect() as connection:
        names = ("reviewer", "question_id", "decision")
        connection.register(
            "reviews", pa.table({n: pa.array(c, pa.string()) for n, c in zip(names, columns, strict=True)})
        )
        return connection.sql(read_statement("stats/agreements.sql")).fetchall()


PAIRS = st.lists(st.tuples(st.sampled_from(["accept", "reject"]), st.sampled_from(["accept", "reject"])), min_size=1)


@pytest.mark.slow
@given(PAIRS)
def test_kappa_is_that_of_statsmodels(pairs):
    # Its import takes seconds.
    from statsmodels.stats import inter_rater

    names = ["accept", "reject"]
    table = [[sum(pair == (a, b) for pair in pairs) for b in names] for a in names]
    rows = [(who, str(number), pair[i]) for number, pair in enumerate(pairs) for i, who in enumerate("ab")]
    ((*counts, ours),) = agreements(rows)
    assert counts == ["a", "b", len(pairs), sum(a == b for a, b in pairs)]
    if ours is None:
        assert len({name for pair in pairs for name in pair}) == 1
    else:
        assert ours == pytest.approx(inter_rater.cohens_kappa(table).kappa)


def test_only_questions_that_both_decided_are_compared():
    reviews = [
        ("a", "1", "accept"),
        ("a", "2", "reject"),
        ("a", "3", "reject"),
        ("b", "2", "reject"),
        ("b", "3", "accept"),
        ("b", "4", "accept"),
        ("c", "9", "accept"),
    ]
    assert agreements(reviews) == [("a", "b", 2, 1, 0.0)]
    assert agreements([]) == []


def test_a_store_without_reviews_rejects_nothing(tmp_path):
    assert rejected(Store(tmp_path)) == frozenset()
    assert pa.array(sorted(rejected(Store(tmp_path))), pa.string()).null_count == 0
