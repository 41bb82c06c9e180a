"""The default sample holds something of everything: questions of every template that can be proven, in numbers."""

from collections import Counter

import pytest
from click.testing import CliRunner

from jrdb_avr.engine.cli import group
from jrdb_avr.queries.store import Store

NAMES = {
    *("start", "span", "change", "presence", "distance", "gap", "consequence"),
    *("two_hop", "three_hop", "fork_join", "action_search", "later_action"),
}
LEAST = 15


def run(*arguments):
    result = CliRunner().invoke(group, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output


@pytest.mark.slow
def test_the_default_sample_yields_candidates_of_every_template(tmp_path):
    root, store = tmp_path / "root", tmp_path / "store"
    run("sample", root, "--no-images")
    run("load", root, "--store", store)
    run("generate", "--store", store, "--profile", "train")
    count = Counter(Store(store).questions("questions")["template"].to_pylist())
    assert {name: count[name] for name in sorted(NAMES) if count[name] < LEAST} == {}
    assert set(count) == NAMES
