"""The default sample holds something of everything: proven candidates of every template, in numbers."""

from collections import Counter

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from jrdb_avr.engine.cli import group

NAMES = {
    *("start", "span", "change", "presence", "distance", "gap", "consequence"),
    *("two_hop", "three_hop", "fork_join", "action_search", "later_action"),
}
LEAST = 30


def run(*arguments):
    result = CliRunner().invoke(group, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output


@pytest.mark.slow
def test_the_default_sample_yields_candidates_of_every_template(tmp_path):
    root, store, found = tmp_path / "root", tmp_path / "store", tmp_path / "candidates.parquet"
    run("sample", root, "--no-images")
    run("load", root, "--store", store)
    run("generate", "--store", store, "--candidates", found)
    count = Counter(pq.read_table(found, columns=["template"])["template"].to_pylist())
    assert {name: count[name] for name in sorted(NAMES) if count[name] < LEAST} == {}
    assert set(count) == NAMES
