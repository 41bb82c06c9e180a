"""All proven candidates of random small worlds against the brute-force oracle: exactly the same ones."""

import random
import re
import tempfile
from collections import Counter
from pathlib import Path

import pytest
from environment import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from keyframe_layers import forms_in, make_prover, proposals, searched
from loaded_stores import memory_store
from oracle_candidates import World, proven
from random_worlds import form, in_crowds, in_other_words, lively_world, random_world, sociable_world, with_chorus
from worlds import person, person_3d

from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.pool import make_candidate
from jrdb_avr.loaders.load import load_shard
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.plan import canonical
from jrdb_avr.schema.rules import LoadRules, Rules
from jrdb_avr.schema.templates import TEMPLATES

SIMPLE = {"start", "span", "change", "presence", "distance"}
CHAINED = {"consequence", "two_hop", "three_hop", "later_action", "action_search", "fork_join", "gap"}
FORMS = {"gap_count", "gap_absence"}
MAKERS = [random_world, lively_world, sociable_world]
MAKERS += [in_other_words(make) for make in MAKERS]
ASKING = {row.name for row in TEMPLATES.values() if row.asks_action}
JUDGED = {"clear": True, "any": False}
"""Whether the oracle judges who is in clear view, by the rule `visibility`."""


def candidates(store, sequence, visibility):
    """What the engine finds and proves, with the answers that may be wrong choices."""
    found = {}
    with searched(store, sequence, Rules(load=LoadRules(visibility=visibility))) as search:
        prover = make_prover(search)
        for template in forms_in(store, sequence):
            for one in proposals(search, template):
                candidate = make_candidate(one)
                if (not template.asks_action or wrong_sets(candidate.wrong)) and prover.prove(one) is not None:
                    key = (template.name, one.target, canonical(one.plan), one.answer)
                    assert key not in found
                    found[key] = candidate.wrong
    return found


def rounded(found):
    """The same candidates, with numbers in answers that do not hang on the last bit of a float."""
    return {(*rest, re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.6f}", answer)) for *rest, answer in found}


def compare(seed, make=random_world, visibility="any"):
    """Check one world; returns how many candidates of each template it has."""
    name = "yard-2020-01-01_0"
    with tempfile.TemporaryDirectory() as folder:
        world = make(random.Random(seed), name)
        try:
            store = memory_store(folder, world, visibility=visibility)
        except InputError:
            return Counter()
        if name not in store.sequences:
            return Counter()
        oracle = World(Path(folder) / "root", name, JUDGED[visibility])
        choices = candidates(store, name, visibility)
        expected, found = rounded(oracle.proven()), rounded(choices)
        assert sorted(found - expected)[:3] == []
        assert sorted(expected - found)[:3] == []
        for (template, target, program, answer), wrong in choices.items():
            if template in ASKING:
                assert list(wrong_sets(wrong)) == oracle.wrong_sets(template, program, target, answer), program
        return Counter(form(template, program) for template, _, program, _ in found)


@settings(max_examples=examples(3), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(0, 10**9),
    st.sampled_from((random_world, in_other_words(random_world), in_crowds(random_world))),
    st.sampled_from([*JUDGED]),
)
def test_awkward_worlds_give_exactly_the_proven_candidates(seed, make, visibility):
    compare(seed, make, visibility)


def test_lively_and_sociable_worlds_give_exactly_the_proven_candidates_of_every_template():
    # Worlds in which there is much to ask; `test_many_worlds` takes them as they come.
    lively = sum((compare(seed, with_chorus(lively_world)) for seed in (0, 5)), Counter())
    assert set(lively) >= SIMPLE
    sociable = sum((compare(seed, with_chorus(sociable_world)) for seed in (7, 12)), Counter())
    assert min(sociable[chain] for chain in CHAINED | FORMS) >= 3, sociable
    compare(1, with_chorus(in_other_words(sociable_world)))


def test_worlds_with_covered_people_give_exactly_the_proven_candidates():
    makers = (lively_world, sociable_world, sociable_world)
    found = sum((compare(seed, with_chorus(in_crowds(make)), "clear") for seed, make in enumerate(makers)), Counter())
    assert min(found[template] for template in (*SIMPLE, "two_hop", "gap")) > 0, found


def test_whose_distance_is_never_known_later_is_asked_nothing_of_it():
    """Nobody has a clear view at a later keyframe, so that no distance is known at any time."""

    def dim(_, name):
        frames = range(0, 91, 15)
        boxes = {f: [person(1, (900, 100, 50, 30 if f else 150), {"reading": 1})] for f in frames}
        return {name: {"2d": boxes, "3d": {f: [person_3d(1, 3.0 + f / 10, 0.0)] for f in frames}}}

    assert compare(0, dim) == Counter()


@pytest.mark.slow
@pytest.mark.parametrize("visibility", JUDGED)
def test_a_sample_gives_exactly_the_proven_candidates(tmp_path, visibility):
    list(write(plan(tmp_path / "root", [(165, 7)], 0, "none"), 1))
    store = Store(tmp_path / "store")
    [files] = find_root(tmp_path / "root").sequences
    load_shard(files, str(store.path), LoadRules(visibility=visibility))
    expected = rounded(proven(tmp_path / "root", files.sequence, JUDGED[visibility]))
    found = rounded(candidates(store, files.sequence, visibility))
    assert sorted(found - expected)[:3] == []
    assert sorted(expected - found)[:3] == []
    assert len(found) > 50


@pytest.mark.slow
@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize(("start", "visibility"), ((1000, "any"), (1200, "clear")))
def test_many_worlds(start, visibility, make):
    make = in_crowds(make) if visibility == "clear" else make
    assert sum((compare(seed, make, visibility) for seed in range(start, start + 20)), Counter()).total() > 0
