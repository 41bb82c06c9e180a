"""`evaluate --plan`: what a run will send, against what the same run then sends."""

import json

import pyarrow.compute as pc
import pytest
from environment import ROOT
from fake_server import FakeServer
from processes import run

from jrdb_avr.agent.methods.requests import PANORAMAS
from jrdb_avr.engine.run.effort import USAGE, prompt_tokens, question_usage
from jrdb_avr.engine.run.methods import METHODS
from jrdb_avr.queries.store import read_table

SERVER_TOKENS = 256
"""Tokens of a picture at the server of the simulated model."""


def plan(store, *options):
    code, out, err = run("evaluate", "--store", str(store.path), "--plan", "--json", *options)
    assert code == 0, err
    return json.loads(out)


def made(store, method, count, *options):
    """Calls, pictures, text tokens and reply tokens of a run."""
    given = ("--store", str(store.path), "--method", method, "--limit", str(count), "--run-id", method, *options)
    code, _, err = run("evaluate", *given)
    assert code == 0, err
    steps, predictions = (read_table(store.run_path(method) / f"{name}.parquet") for name in ("steps", "predictions"))
    sent = steps.filter(pc.equal(steps["kind"], "model"))["request"].to_pylist()
    pictures = sum(text.count("[image ") for text in sent)
    tokens, replies = (pc.sum(predictions[name]).as_py() for name in ("prompt_tokens", "completion_tokens"))
    return {
        "calls": len(sent),
        "pictures": pictures,
        "text_tokens": tokens - SERVER_TOKENS * pictures,
        "reply_tokens": replies,
    }


def test_fixed_methods_send_exactly_what_is_planned(benchmark_copy):
    for method in METHODS[:3]:
        (row,) = plan(benchmark_copy, "--method", method, "--model", "simulated:perfect", "--limit", "60")
        counts = made(benchmark_copy, method, 60, "--model", "simulated:perfect")
        assert row["questions"] == 60 and row["prompt_tokens"] is None
        assert (row["calls"], row["pictures"]) == (counts["calls"], counts["pictures"])
        assert row["reply_tokens_low"] <= counts["reply_tokens"] <= row["reply_tokens_high"]
        # By the server's own count of the same requests. The pictures are equal, so only texts can differ.
        planned = question_usage(method, [PANORAMAS] * 60)["text_tokens"][0]
        assert counts["text_tokens"] == pytest.approx(planned, rel=0.02)


@pytest.mark.parametrize("method", ["search-recognize", "react", "agent", "agent-passive", "agent-passive-no-world"])
def test_a_run_is_within_the_planned_bounds(benchmark_copy, method):
    """Another sample than the measured one, with errors and malformed replies."""
    model = ("--model", "simulated", "--simulate", "malformed=0.1", "--simulate", "seed=7")
    (row,) = plan(benchmark_copy, "--method", method, *model, "--limit", "8")
    counts = made(benchmark_copy, method, 8, *model)
    for name in ("calls", "pictures", "reply_tokens"):
        assert row[f"{name}_low"] <= counts[name] <= row[f"{name}_high"], name


def test_a_plan_of_the_paper_sends_nothing(benchmark_copy, tmp_path):
    (tmp_path / "prices.toml").write_text('["Qwen/Qwen3.5-9B"]\ninput = 1\noutput = 2\n')
    with FakeServer(lambda request, n: "{}") as server:
        rate = ("--tpm", "100000", "--base-url", server.url, "--simulated", "--limit", "10")
        rows = plan(benchmark_copy, "--matrix", "paper", *rate)
        priced = plan(
            benchmark_copy,
            "--matrix",
            "paper",
            *rate,
            "--model",
            "Qwen/Qwen3.5-9B",
            "--prices",
            str(tmp_path / "prices.toml"),
        )
        assert not server.requests
    assert len(rows) == 28 and len(priced) == 8
    by_run = {(row["model"], row["method"]): row for row in rows}
    for model, panorama, crop in (("Qwen/Qwen3.5-9B", 1770, 225), ("google/gemma-4-E2B-it", 230, 256)):
        row, text = by_run[model, "search-recognize"], USAGE["search-recognize"]["text_tokens"][0]
        assert row["prompt_tokens"] == round(10 * (9 * panorama + 2 * crop + text))
        assert row["hours"] == pytest.approx((row["prompt_tokens"] + row["reply_tokens"]) / 6e6, abs=0.005)
    assert priced[0]["dollars"] == pytest.approx(
        (priced[0]["prompt_tokens"] + 2 * priced[0]["reply_tokens"]) / 1e6, abs=0.005
    )


def test_a_plan_of_another_method_is_refused(benchmark_copy):
    code, _, err = run(
        "evaluate", "--store", str(benchmark_copy.path), "--plan", "--method", "a.py:b", "--model", "none"
    )
    assert code != 0 and "--plan knows the calls of" in err


@pytest.mark.parametrize("method", METHODS)
def test_the_tokens_of_the_readme_are_computed(method):
    usage = question_usage(method, [PANORAMAS])
    tokens = [prompt_tokens(usage, model)[0] for model in ("Qwen/Qwen3.5-9B", "google/gemma-4-E4B-it")]
    cells = " | ".join(f"{round(int(count), -2):,}" for count in tokens)
    row = next(
        line for line in (ROOT / "README.md").read_text("utf-8").splitlines() if line.startswith(f"| `{method}` |")
    )
    assert row.endswith(f" | {cells} |")
