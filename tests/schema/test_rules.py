"""Rules: frozen, hashed, overridden by name."""

import contextlib
import json

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import LoadRules, Rules, frames, override, rules_hash


def test_hashes_are_stable():
    assert rules_hash(Rules()) == rules_hash(Rules())
    assert rules_hash(Rules()) != rules_hash(LoadRules())
    assert len(rules_hash(Rules())) == 16


@pytest.mark.parametrize("name", LoadRules.__struct_fields__)
def test_every_load_rule_changes_both_hashes(name):
    value = getattr(LoadRules(), name)
    other = {"clear": "any", "any": "clear"}[value] if name == "visibility" else value + (-0.1 if value < 1 else 1)
    changed = msgspec.structs.replace(LoadRules(), **{name: other})
    assert rules_hash(changed) != rules_hash(LoadRules())
    assert rules_hash(Rules(load=changed)) != rules_hash(Rules())


@pytest.mark.parametrize("name", [name for name in Rules.__struct_fields__ if name not in ("load", "condition_order")])
def test_every_rule_can_be_overridden(name):
    value = getattr(Rules(), name)
    value = "both" if value == "either" else value - 1 if isinstance(value, int) else value * 0.9
    changed = override(Rules(), {name: json.dumps(value)})
    assert getattr(changed, name) == value
    assert rules_hash(changed) != rules_hash(Rules())
    assert changed.load == Rules().load


def test_load_rules_are_overridden_by_their_path():
    changed = override(Rules(), {"load.gap_frames": "3", "max_per_person": "2"})
    assert (changed.load.gap_frames, changed.max_per_person) == (3, 2)
    assert override(Rules(), {}) == Rules()
    # A word needs no quotes.
    assert override(Rules(), {"time_shift": "both"}) == override(Rules(), {"time_shift": '"both"'})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("nothing", "1"),
        ("load.nothing", "1"),
        ("gap_frames", "3"),
        ("load", "{}"),
        ("load.load.gap_frames", "3"),
        ("max_per_person", "many"),
        ("max_per_person", '"3"'),
        ("max_per_person", "2.5"),
        ("load.gap_frames", "null"),
        ("load.gap_frames", "\udcff"),
        ("time_shift", "neither"),
        (".", "1"),
    ],
)
def test_wrong_overrides_are_refused(name, value):
    with pytest.raises(InputError) as error:
        override(Rules(), {name: value})
    assert "\n" not in str(error.value)


@given(st.text(max_size=12), st.text(max_size=6))
def test_any_override_is_applied_or_refused(name, value):
    with contextlib.suppress(InputError):
        assert isinstance(override(Rules(), {name: value}), Rules)


def test_seconds_are_frames():
    assert [frames(s) for s in (0, 1, 2, 3, 0.5)] == [0, 15, 30, 45, 8]


def test_rules_are_frozen():
    with pytest.raises(AttributeError):
        Rules().shift_s = 1.0


@pytest.mark.parametrize("name", LoadRules.__struct_fields__)
@pytest.mark.parametrize("value", ["-1", "1e300"])
def test_a_load_rule_out_of_its_range_is_refused(name, value):
    with pytest.raises(InputError, match=name):
        override(Rules(), {f"load.{name}": value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("min_wait_s", "-5"),
        ("min_wait_s", "0"),
        ("shift_s", "0.01"),
        ("max_conditions", "4"),
        ("visible_share", "0"),
        ("near_duplicate_s", "-1"),
        ("max_per_person", "0"),
        ("distance_same_m", "2"),
        ("condition_order", '["pose"]'),
        ("condition_order", '["pose", "pose"]'),
        ("load.sector_true_deg", "45.1"),
        ("load.sector_false_deg", "44.9"),
        ("load.distance_margin", "0.34"),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused(name, value):
    with pytest.raises(InputError, match="rules: "):
        override(Rules(), {name: value})
