"""The tasks of Inspect, run by its own `eval`: predictions as by `evaluate`, and nothing private in a log."""

import json
import os
from types import SimpleNamespace

import pytest
from environment import needs
from question_files import blocked_store

from jrdb_avr.queries.questions import read_question_rows
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError
from jrdb_avr.schema.panorama import Box, iou

needs("inspect_ai", "openai")


@pytest.fixture
def run(model, tmp_path, monkeypatch):
    """Run a task on the simulated model, or another; returns the log."""
    import inspect_ai
    from inspect_ai.model import GenerateConfig, get_model

    monkeypatch.setenv("SIMULATED_API_KEY", "none")
    declared = GenerateConfig(extra_body={"simulated": True})

    def run(task, own=None, **options):
        own = own or get_model("openai-api/simulated/perfect", base_url=model[0], config=declared)
        options = {"log_dir": str(tmp_path / "logs"), "display": "none", **options}
        (log,) = inspect_ai.eval(task, model=own, **options)
        assert log.status == "success", log.error
        return log

    return run


@pytest.fixture
def blocked(small_demo, tmp_path):
    """A whole store whose private files are pipes that whoever opens them waits at for ever."""
    return str(blocked_store(small_demo.folder / "store", tmp_path / "store").path)


def rows_of(log):
    from jrdb_avr.engine.integrations.inspect_ai import PREDICTION

    return [sample.store[PREDICTION] for sample in log.samples]


def metrics(log):
    return {(score.name, own.name): own.value for score in log.results.scores for own in score.metrics.values()}


@pytest.mark.parametrize("name", [pytest.param("react", marks=pytest.mark.slow), "tools"])
def test_the_simulated_model_plays_as_in_evaluate_without_anything_private(
    blocked, run, same, small_demo, secrets, model, name
):
    """Scored afterwards, where the answers are."""
    import inspect_ai

    from jrdb_avr.engine.integrations import inspect_ai as door

    log = run(getattr(door, name)(blocked, limit=3), score=False)
    rows = rows_of(log)
    same(rows)
    assert len(rows) == 3 and {sample.target for sample in log.samples} == {""}
    text = log.model_dump_json()
    assert not [secret for secret in secrets if secret in text or any(secret.encode() in own for own in model[1])]
    scored = inspect_ai.score(log, door.judged(str(small_demo.folder / "store")), display="none")
    found = metrics(scored)
    assert {found[part, "mean"] for part in ("answer", "evidence", "combined")} == {1.0}
    assert found["hallucination", "mean"] == 0.0
    text = scored.model_dump_json()
    assert not [secret for secret in secrets if secret in text]


def test_a_log_names_the_questions_and_scores_say_what_was_predicted(small_demo, run, by_evaluate, store):
    import inspect_ai
    from inspect_ai.log import read_eval_log

    from jrdb_avr.engine.integrations import inspect_ai as door

    whole = Store(small_demo.folder / "store")
    log = run(door.react(str(whole.path), limit=2), score=False)
    manifest = read_run_manifest(whole, "react-simulated-perfect")
    written = read_eval_log(log.location)
    assert written.eval.metadata == {
        "generation": whole.questions("questions").schema.metadata[b"generation"].decode(),
        "questions_sha256": manifest.questions_sha256,
        "profile": "benchmark",
        "load_rules_hash": whole.manifest().load_rules_hash,
    }
    for sample in written.samples:
        # The turns with their pictures, each part once.
        row = by_evaluate[sample.id]
        replies = [message for message in sample.messages if message.role == "assistant"]
        parts = [part for message in sample.messages if message.role == "user" for part in message.content]
        assert len(replies) == row["n_model_calls"] and row["raw"] == replies[-1].text
        pictures = [part.image for part in parts if part.type == "image"]
        assert len(set(pictures)) == len(pictures) == row["n_observations"]

    public = inspect_ai.score(written, door.judged(str(whole.path)), display="none")
    assert public.results.scores[0].name == "combined"
    labels = {row.question_id: row for row in read_question_rows(whole)}
    asked = [labels[sample.id] for sample in public.samples]
    kinds = {f"{kind} {getattr(row, kind)}" for row in asked for kind in ("family", "template")}
    # Fewer than ten sequences have no standard error.
    assert {name for score, name in metrics(public) if score == "combined"} == {"mean", *kinds}
    truth = {row["question_id"]: json.loads(row["answer"]) for row in whole.questions("answers").to_pylist()}
    private = inspect_ai.score(written, door.judged(str(whole.path), gold=True), display="none")
    for sample, known in zip(public.samples, private.samples, strict=True):
        shown, row = sample.scores["judged"].metadata, by_evaluate[sample.id]
        box = [row[f"evidence_{side}"] for side in "xywh"]
        assert shown == {
            "family": labels[sample.id].family,
            "template": labels[sample.id].template,
            "answer": json.loads(row["answer"]),
            "evidence": {"frame": row["evidence_frame"], "box": box},
            "reason": None,
        }
        gold = known.scores["judged"].metadata
        assert gold.keys() - shown.keys() == {"gold_answer", "gold_box", "iou"}
        assert gold["gold_answer"] == truth[sample.id] and gold["iou"] == pytest.approx(
            iou(Box(*box), Box(*gold["gold_box"]))
        )
    # A wrong box beside a right answer, and a wrong answer, which does not count.
    first, second = (row for row in rows_of(written))
    first["evidence_x"], second["answer"] = first["evidence_x"] + 1000, None
    changed = inspect_ai.score(written, door.judged(str(whole.path)), display="none")
    assert (metrics(changed)["answer", "mean"], metrics(changed)["hallucination", "mean"]) == (0.5, 1.0)
    with pytest.raises(AvrError, match="has no question"):
        inspect_ai.score(written, door.judged(str(store.path)), display="none")


def test_standard_errors_need_ten_sequences():
    from inspect_ai.scorer import SampleScore, Score

    from jrdb_avr.engine.integrations.inspect_ai import clustered

    def scores(sequences):
        return [SampleScore(score=Score(value=i % 2), sample_metadata={"sequence": str(i)}) for i in range(sequences)]

    assert clustered()(scores(9)) == {}
    assert clustered()(scores(10)) == {"stderr": pytest.approx((10 * 0.25 * 10 / 9) ** 0.5 / 10)}


def test_other_methods_play_too_and_unknown_ones_are_refused(small_demo, run):
    from jrdb_avr.engine.integrations import inspect_ai as door

    store = str(small_demo.folder / "store")
    log = run(door.react(store, limit=1), solver=door.method("monolithic", store))
    (row,) = rows_of(log)
    assert (row["status"], row["n_observations"], row["n_model_calls"]) == ("answered", 8, 1)
    for name in ("agent", "nope"):
        with pytest.raises(AvrError, match="is not one of monolithic"):
            door.method(name, store)


def test_a_limit_ends_a_sample_and_keeps_what_was_played(small_demo, run):
    from jrdb_avr.engine.integrations import inspect_ai as door

    log = run(door.tools(str(small_demo.folder / "store"), limit=1), message_limit=6)
    (row,) = rows_of(log)
    assert log.samples[0].limit.type == "message" and row["n_observations"] >= 1 and row["answer"] is None
    assert metrics(log)["combined", "mean"] == 0.0


def test_replies_that_call_no_tool_cost_turns_and_end(small_demo, run):
    from inspect_ai.model import ModelOutput, ModelUsage, get_model

    from jrdb_avr.engine.integrations import inspect_ai as door

    def reply(*_):
        output = ModelOutput.from_content("mockllm/model", "I think it is 2.")
        output.usage = ModelUsage(input_tokens=1, output_tokens=1, total_tokens=2)
        return output

    log = run(door.tools(str(small_demo.folder / "store"), limit=1), get_model("mockllm/model", custom_outputs=reply))
    (row,) = rows_of(log)
    assert (row["status"], row["n_model_calls"], row["n_observations"]) == ("invalid", 50, 0)
    assert row["reason"] == "the reply calls no tool"


def test_the_installed_package_offers_the_tasks():
    from importlib.metadata import entry_points

    if found := [own for own in entry_points(group="inspect_ai") if own.name == "jrdb_avr"]:
        assert {"react", "tools", "judged", "method"} <= vars(found[0].load()).keys()
    else:
        assert not os.environ.get("REQUIRE_EXTRAS")


@pytest.mark.slow
def test_a_judge_whose_process_has_ended_is_replaced(small_demo, by_evaluate, monkeypatch):
    import asyncio

    from jrdb_avr.engine.integrations import inspect_ai as door

    opened, begin = [], door.Judge.open
    recorded = SimpleNamespace(open=lambda store: opened.append(begin(store)) or opened[-1])
    monkeypatch.setattr(door, "Judge", recorded)
    row = next(iter(by_evaluate.values()))
    state = SimpleNamespace(sample_id=row["question_id"], store={door.PREDICTION: row})

    async def twice():
        score = door.judged(str(small_demo.folder / "store"))
        before = await score(state, None)
        opened[0]._process.kill()
        opened[0]._process.wait()
        return before, await score(state, None)

    before, after = asyncio.run(twice())
    assert before.value == after.value and len(opened) == 2
    with pytest.raises(AvrError):
        asyncio.run(door.judged("nowhere")(state, None))
    opened[1].close()
