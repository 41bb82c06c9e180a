"""Shards of a run, merged: they make the run that one machine would have made."""

import json
import shutil
from operator import attrgetter

import pyarrow.parquet as pq
import pytest
from fake_server import recorded_server
from painted import FRAMES, SEQUENCE, asked_sight, question, write_answers, write_public, write_store
from processes import run

from jrdb_avr.engine.run.merging import merge_runs
from jrdb_avr.queries.beliefs.graph import make_world_tables
from jrdb_avr.queries.graph.handle import build_graph
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

NAMES = (SEQUENCE, "second", "third")
ASKED = [question(t0, t1, name) for name in NAMES for t0, t1 in ((0, 90), (15, 105))]
ASKED.sort(key=attrgetter("question_id"))


@pytest.fixture
def stores(asked_world, tmp_path):
    """Equal stores of three sequences by name: `whole`, and a copy for each shard."""
    images = tmp_path / "images"
    for name in NAMES:
        shutil.copytree(asked_world / "images" / SEQUENCE, images / name)
    made = write_store(tmp_path / "whole", images, ASKED, NAMES)
    write_public(made, ASKED, dict.fromkeys(NAMES, FRAMES))
    with build_graph(made.graph_path) as graph:
        make_world_tables(graph)
    write_answers(made, ASKED)
    for number in "123":
        shutil.copytree(made.path, tmp_path / number)
    return {name: Store(tmp_path / name) for name in ("whole", "1", "2", "3")}


def evaluate(store, *options):
    code, out, err = run("evaluate", "--store", store.path, "--model", "simulated:perfect", "--json", *options)
    assert code == 0, err
    return json.loads(out)[0]


def shard(origins, whole, *options):
    """Evaluate each shard in its store, copy it into the store `whole`, and return the run ids and sizes."""
    sizes = {}
    for number, store in enumerate(origins, 1):
        part, name = f"{number}/{len(origins)}", f"r-{number}of{len(origins)}"
        sizes[name] = evaluate(store, "--method", "react", "--run-id", "r", "--shard", part, *options)["n"]
        if store is not whole:
            shutil.copytree(store.run_path(name), whole.run_path(name))
    return list(sizes), list(sizes.values())


def rows(store, run_id):
    """The tables of a run without run ids and clock times; keys of facts begin with the run's id."""
    found = {}
    for name in ("predictions", "steps", "world"):
        table = pq.read_table(store.run_path(run_id) / f"{name}.parquet")
        columns = [column for column in table.column_names if column not in ("run_id", "seconds")]
        found[name] = table.select(columns).to_pylist()
    for row in found["world"]:
        row["fact"] = row["fact"].replace(f'"{run_id}/', '"R/').replace(f'"run":"{run_id}"', '"run":"R"')
    return found


@pytest.mark.parametrize("method", [pytest.param("react", marks=pytest.mark.slow), "agent"])
def test_merged_shards_are_the_whole_run(stores, method):
    whole = stores["whole"]
    evaluate(whole, "--method", method, "--run-id", "all")
    names, sizes = shard([stores[n] for n in "123"], whole, "--method", method)
    assert sizes == [2, 2, 2]
    code, _, err = run("runs", "merge", *names, "--run-id", "r", "--store", whole.path)
    assert code == 0, err
    assert rows(whole, "r") == rows(whole, "all")
    one, other = (read_run_manifest(whole, name) for name in ("r", "all"))
    assert (set(one.question_ids), one.selection) == (set(other.question_ids), other.selection)
    if method == "agent":
        # The processor time of two runs is never equal.
        assert one.world.pop("cpu_ms") and other.world.pop("cpu_ms")
        assert one.world == other.world and rows(whole, "r")["world"]
        _, out, _ = run("cypher", "world_runs", "--store", whole.path, "--json")
        counts = {row.pop("run"): row for row in json.loads(out)}
        assert counts["r"] == counts["all"]
    assert run("score", "r", "all", "--store", whole.path)[0] == 0
    scores = {n: pq.read_table(whole.run_path(n) / "scores.parquet").drop_columns(["run_id"]) for n in ("r", "all")}
    assert scores["r"] == scores["all"] and sum(scores["r"]["answer_score"].to_pylist()) > 0
    assert evaluate(whole, "--method", method, "--run-id", "r", "--resume")["answered"] == len(ASKED)
    assert "exists" in run("runs", "merge", *names, "--run-id", "r", "--store", whole.path)[2]


def test_an_empty_shard_merges(stores):
    whole = stores["whole"]
    names, sizes = shard([stores[n] for n in "123"], whole, "--sequence", SEQUENCE)
    assert sorted(sizes) == [0, 0, 2]
    assert run("runs", "merge", *names, "--run-id", "r", "--store", whole.path)[0] == 0
    assert len(rows(whole, "r")["predictions"]) == 2


def test_shards_that_do_not_fit_are_refused_in_a_line(stores):
    whole = stores["whole"]
    evaluate(whole, "--method", "react", "--shard", "1/2", "--run-id", "r")

    def refusal(*options):
        shutil.rmtree(whole.run_path("r-2of2"), ignore_errors=True)
        evaluate(whole, "--method", "react", "--shard", "2/2", "--run-id", "r", *options)
        code, _, err = run("runs", "merge", "r-1of2", "r-2of2", "--run-id", "m", "--store", whole.path)
        assert code == 1 and err.count("\n") == 1 and not whole.run_path("m").exists()
        return err

    assert "differ in the request settings" in refusal("--max-tokens", "99")
    assert "differ in the method settings" in refusal("--history", "3")
    assert "differ in the simulated" in refusal("--simulate", "seed=3", "--simulate", "wrong_box=0.1")
    assert "differ in the model" in refusal("--model", "simulated:independent")
    assert "differ in the method" in refusal("--method", "monolithic")
    assert "differ in the selection" in refusal("--limit", "3")
    evaluate(whole, "--method", "react", "--run-id", "r", "--shard", "2/3")
    evaluate(whole, "--method", "react", "--run-id", "plain")
    for others, why in (
        (["r-2of3"], "differ in the number of shards"),
        (["plain"], "'plain' is not a shard"),
        ([], "the runs are the shards 1 of 2: give each shard once"),
    ):
        code, _, err = run("runs", "merge", "r-1of2", *others, "--run-id", "m", "--store", whole.path)
        assert code == 1 and why in err and err.count("\n") == 1
    write_public(whole, ASKED[1:], dict.fromkeys(NAMES, FRAMES))
    assert "other questions" in run("runs", "merge", "r-1of2", "--run-id", "m", "--store", whole.path)[2]


def test_shards_and_bundles_of_an_opaque_public_store_fit_the_full_store(stores, tmp_path):
    whole, public = stores["whole"], Store(tmp_path / "public")
    assert run("export", "--store", whole.path, "--public", public.path, "--opaque")[0] == 0
    with recorded_server(asked_sight()) as (url, _):
        shard([public, public], whole, "--limit", "5", "--base-url", url)
    code, _, err = run("runs", "merge", "r-1of2", "r-2of2", "--run-id", "r", "--store", whole.path)
    assert code == 0 and "5 predictions (" in err, err
    merged = pq.read_table(whole.run_path("r") / "predictions.parquet")["question_id"].to_pylist()
    assert set(merged) <= {question.question_id for question in ASKED} and len(merged) == 5
    size = len(read_run_manifest(public, "r-1of2").question_ids)
    assert run("submit", "--store", public.path, "r-1of2", tmp_path / "bundle")[0] == 0
    code, out, err = run("score", "--store", whole.path, "--json", "--bundle", tmp_path / "bundle")
    assert code == 0 and json.loads(out)[0]["n"] == size, err


def test_a_merge_makes_the_whole_run_or_none(stores):
    whole = stores["whole"]
    shard([whole, whole], whole)
    evaluate(whole, "--method", "react", "--run-id", "r", "--limit", "2")
    (whole.run_path("r") / "predictions.parquet").unlink()
    with pytest.raises(StoreError, match="run 'r' exists"):
        merge_runs(whole, ["r-1of2", "r-2of2"], "r")
    path = whole.run_path("r-1of2") / "run.json"
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps(manifest | {"question_ids": manifest["question_ids"][1:]}))
    with pytest.raises(StoreError, match="other questions than their selection"):
        merge_runs(whole, ["r-1of2", "r-2of2"], "m")
    for hostile in ([3], None, 3, {"3": 3}, [3.0, 3], [3, 10**15]):
        path.write_text(json.dumps(manifest | {"selection": {"shard": hostile}}))
        with pytest.raises(StoreError):
            merge_runs(whole, ["r-1of2"], "m")
    path.write_text(json.dumps(manifest))
    for journal in (whole.run_path("r-1of2") / "journal").glob("*.jsonl"):
        journal.write_bytes(b"")
    with pytest.raises(StoreError, match="'r-1of2' lacks 4 answers: finish it with --resume"):
        merge_runs(whole, ["r-1of2", "r-2of2"], "m")


def test_shards_of_another_key_are_refused_with_the_remedy(stores):
    shard([stores["1"], stores["2"]], stores["whole"], "--opaque")
    with pytest.raises(StoreError, match=r"differ in the opaque\.key: copy opaque\.key of one store to each store"):
        merge_runs(stores["whole"], ["r-1of2", "r-2of2"], "m")
