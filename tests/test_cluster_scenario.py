"""The whole program from an object store on a cluster of two machines, with workers killed: what folders here give."""

import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from extras import needs

needs("moto", "boto3", "ray")

SCRIPT = Path(__file__).with_name("benchmarks") / "bench_cluster.py"


def test_all_stages_from_urls_on_a_cluster_give_what_folders_do():
    size = ("--sequences=2", "--frames=90", "--people=6", "--questions=8")
    done = subprocess.run([sys.executable, SCRIPT, *size], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in done.stdout.splitlines()[2:]]
    assert [row[0] for row in rows] == ["load", "generate", "evaluate", "score", "report"]
    assert {row[-1] for row in rows} == {"yes"}


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    import bench_cluster

    return bench_cluster


def test_a_difference_is_seen(script, tmp_path):
    for store, seconds, status in (("here", 1.0, "answered"), ("there", 2.0, "answered"), ("other", 2.0, "error")):
        folder = tmp_path / store / "runs" / "run"
        folder.mkdir(parents=True)
        pq.write_table(pa.table({"status": [status], "seconds": [seconds]}), folder / "predictions.parquet")
        pq.write_table(pa.table({"seconds": [seconds]}), folder / "scores.parquet")
    compare = [(tmp_path / "here", tmp_path / store) for store in ("there", "other")]
    assert [script.differing(*pair, ("runs/run/predictions.parquet",)) for pair in compare] == [
        [],
        ["runs/run/predictions.parquet"],
    ]
    assert script.differing(*compare[0], ("runs/",)) == ["runs/run/scores.parquet"]
    (tmp_path / "there/runs/run/scores.parquet").unlink()
    assert script.differing(*compare[0], ("runs/",)) == ["runs/run/scores.parquet"]
    one, other = ('[{"answer": 1, "seconds": 2}]', '[{"answer": 2, "seconds": 2}]')
    assert script.figures(one) == script.figures(one.replace("2", "3")) != script.figures(other)
