"""What the tests of the integrations share: the simulated model, a store as a machine without answers has it."""

import json
import shutil

import pyarrow.parquet as pq
import pytest
from fake_server import recorded_server
from question_files import all_evidence

from jrdb_avr.agent.simulated.sight import Sight
from jrdb_avr.queries.store import Store

PLAYED = ("status", "answer", "evidence_frame", *(f"evidence_{side}" for side in "xywh"), "reason", "verdict")
COUNTED = ("n_observations", "n_model_calls")


@pytest.fixture(scope="module")
def model(small_demo):
    """The address of a simulated model, and the bodies of all requests."""
    with recorded_server(Sight(Store(small_demo.folder / "store"))) as recorded:
        yield recorded


@pytest.fixture(scope="session")
def by_evaluate(small_demo):
    """Predictions of ReAct with the simulated model, by `evaluate`: {question id: row}."""
    rows = pq.read_table(
        small_demo.folder / "store" / "runs" / "react-simulated-perfect" / "predictions.parquet"
    ).to_pylist()
    assert len(rows) == 6 and {row["status"] for row in rows} == {"answered"}
    return {row["question_id"]: row for row in rows}


@pytest.fixture
def public_store(small_demo, tmp_path):
    """A store without answers, and a folder of its panoramas beside which there are no labels."""
    whole, bare = Store(small_demo.folder / "store"), Store(tmp_path / "public")
    (bare.path / "questions").mkdir(parents=True)
    for name in ("questions", "sequences"):
        shutil.copy(whole.question_path(name), bare.question_path(name))
    shutil.copytree(whole.manifest().image_root, tmp_path / "pictures")
    return bare, str(tmp_path / "pictures")


@pytest.fixture
def same(by_evaluate):
    """Compare predictions with those of `evaluate`."""

    def check(rows, counts=COUNTED):
        assert rows
        for row in rows:
            expected = by_evaluate[row["question_id"]]
            for name in (*PLAYED, *counts):
                assert row[name] == expected[name], (row["question_id"], name)

    return check


@pytest.fixture(scope="session")
def secrets(small_demo):
    """Texts of the private tables that nothing public holds."""
    store = Store(small_demo.folder / "store")
    answers, evidence = (table.to_pylist() for table in (store.questions("answers"), all_evidence(store)))
    boxes = {f"{row[side]!r}" for row in evidence for side in "xywh" if len(f"{row[side]!r}") > 12}
    plans = {row[name] for row in answers for name in ("plan", "bindings", "proofs")}
    found = {text for text in boxes | plans if len(text) > 12}
    assert len(found) > 20
    return {*found, "target_track"}


@pytest.fixture(scope="session")
def played(small_demo):
    """The moves of the simulated model by question."""
    query = "select question_id, response from steps where run_id = $run and kind = 'model' order by question_id, step"
    moves = {}
    for row in Store(small_demo.folder / "store").sql(query, run="react-simulated-perfect").to_pylist():
        moves.setdefault(row["question_id"], []).append(json.loads(json.loads(row["response"])["content"]))
    return moves
