"""All thresholds of the benchmark.

The command `load` applies `LoadRules`. The graph stores a hash of them, and questions are generated only from a graph
with the same load rules. `Rules` adds the thresholds of generation. Each row of `answers` has a hash of `Rules`. Most
lengths of time are in seconds. The program compares frames, and `frames` converts seconds to frames.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Final, Literal

import msgspec

from jrdb_avr.schema.errors import InputError, did_you_mean

FPS: Final = 15.0
"""Frames per second of every JRDB sequence."""

KEYFRAME_STEP: Final = 15
"""Number of frames from one keyframe to the next. There is one keyframe per second."""

SLACK: Final = 1e-9
"""Tolerance in degrees or metres, because decimals such as 0.55 have no exact float."""


def frames(seconds: float) -> int:
    """Convert seconds to frames.

    Args:
        seconds: Length in seconds.

    Returns:
        The nearest number of frames.
    """
    return round(seconds * FPS)


Pixels = Annotated[float, msgspec.Meta(ge=0, le=10_000)]
Metres = Annotated[float, msgspec.Meta(ge=0, le=1000)]
Seconds = Annotated[float, msgspec.Meta(ge=0, le=3600)]
Wait = Annotated[float, msgspec.Meta(ge=1, le=3600)]
"""Seconds between two times of a question.

The minimum is one keyframe step, because otherwise both times could be the same keyframe.
"""
Share = Annotated[float, msgspec.Meta(gt=0, le=1)]

CONDITION_KINDS: Final = (
    "gender",
    "age",
    "pose",
    "action",
    "object",
    "interaction",
    "group_size",
    "sector",
    "distance",
)


class LoadRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Thresholds that decide in `load` whether a fact is true, false or unknown.

    The text below each field is the meaning that `rules list` prints. The maximum of `distance_margin` is so small that
    at most two distance words are possible for one distance.
    """

    gap_frames: Annotated[int, msgspec.Meta(ge=0, le=900)] = 7
    """Maximum length in frames of a gap between equal labels that is closed. Applies to layers with every frame."""
    clear_min_width: Pixels = 12.0
    """Minimum width of a box for a clear view, in pixels."""
    clear_min_height: Pixels = 40.0
    """Minimum height of a box for a clear view, in pixels."""
    clear_max_width: Pixels = 480.0
    """Maximum width of a box for a clear view, in pixels. A wider box does not fit into a crop."""
    visibility: Literal["clear", "any"] = "clear"
    """Without occlusion attributes, clear judges views by nearer boxes and group labels; any takes all as clear."""
    max_covered: Share = 0.5
    """Minimum covered share of a box that is no clear view. Applies to sequences without occlusion attributes."""
    min_covered: Share = 0.8
    """Minimum covered share of the box of a covered person. Applies to sequences without occlusion attributes."""
    sector_true_deg: Annotated[float, msgspec.Meta(gt=0, le=45)] = 40.0
    """A sector such as "ahead of the robot" is true of a person who is at most this many degrees off its axis."""
    sector_false_deg: Annotated[float, msgspec.Meta(ge=45, lt=180)] = 90.0
    """A sector is false of a person who is more degrees off its axis. Between both limits the sector is unknown."""
    distance_margin: Annotated[float, msgspec.Meta(ge=0, le=0.33)] = 0.10
    """Share of a bound between two distance words within which both words are possible, on each side of the bound."""
    pair_max_m: Metres = 5.0
    """Maximum distance in metres of a relation in space between two people, such as "in front of"."""
    pair_margin_m: Metres = 0.5
    """A relation in space is unknown if the distance is within this many metres of `pair_max_m`: from 4.5 to 5.5 m."""
    pair_vertical_m: Metres = 1.35
    """Maximum difference in height in metres. Above it, the relation in space is unknown, as between two floors."""
    neighbor_max_deg: Annotated[float, msgspec.Meta(ge=0, le=180)] = 90.0
    """Maximum angle in degrees from a person to the first person on the left or right, as the robot sees them."""
    neighbor_margin_deg: Annotated[float, msgspec.Meta(ge=0, le=180)] = 1.0
    """Minimum angle in degrees from a person to the first person at a side, and from the first person to the second.

    If an angle is smaller, the first person is unknown.
    """
    segment_min_s: Seconds = 2.0
    """Minimum length of a stable segment of an action, in seconds."""
    segment_edge_s: Seconds = 1.0
    """Seconds before a stable segment, and after a closed one, with the action false and the person present."""
    segment_quiet_s: Seconds = 3.0
    """Seconds before and after a stable segment without a frame with a true or unknown action."""

    def __post_init__(self) -> None:
        if self.min_covered < self.max_covered:
            raise ValueError("min_covered is at least max_covered, or a person could be clear and covered")

    def covered_thousandths(self) -> tuple[int, int]:
        """Return `max_covered` and `min_covered` in whole thousandths.

        Shares of areas are compared in integers.
        """
        return round(1000 * self.max_covered), round(1000 * self.min_covered)


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All thresholds of the benchmark. The field `load` has the thresholds that the command `load` applies."""

    load: LoadRules = LoadRules()
    condition_order: tuple[str, ...] = CONDITION_KINDS
    """Order of preference among kinds of conditions. It decides between descriptions with equally many conditions."""
    max_conditions: Annotated[int, msgspec.Meta(ge=1, le=3)] = 3
    """Maximum number of conditions in a description of a person."""
    min_wait_s: Wait = 3.0
    """Minimum time in seconds between two times that a question states."""
    long_wait_s: Wait = 10.0
    """Minimum time in seconds that a question of the family long_range covers."""
    search_wait_s: Wait = 2.0
    """Minimum time in seconds from the description to the start of the action, in the template action_search."""
    turn_deg: Annotated[float, msgspec.Meta(ge=0, lt=180)] = 20.0
    """Minimum change of the person's panorama angle in degrees from the description to the start, in action_search."""
    gap_min_s: Seconds = 5.0
    """Minimum time in seconds between two events if the answer is the number of seconds between them."""
    count_min: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 4
    """Minimum number of people if the answer is a number of people."""
    shift_s: Wait = 3.0
    """Shift of the times of a question in the proof time.shift, in seconds."""
    time_shift: Literal["either", "both"] = "either"
    """Which of the two time shifts must change the answer: at least one (either), or all inside the sequence (both)."""
    distance_changed_m: Metres = 1.5
    """Minimum change of distance in metres for the answers "closer" and "farther"."""
    distance_same_m: Metres = 0.5
    """Maximum change of distance in metres for "about the same". Changes between both limits give no question."""
    visible_share: Share = 0.5
    """Minimum share of a box's width inside a view for the view to show the box."""
    near_duplicate_s: Seconds = 2.0
    """Maximum time in seconds between the answer frames of two near-duplicates.

    Near-duplicates are questions of one template about one person. Generation keeps only one of them.
    """
    near_presence_s: Seconds = 5.0
    """Maximum time in seconds between the answer frames of two near-duplicates of the template presence."""
    max_per_person: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 12
    """Maximum number of questions about one person in one template."""
    max_per_person_in_all: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 24
    """Maximum number of questions about one person in all templates."""

    def __post_init__(self) -> None:
        if sorted(self.condition_order) != sorted(CONDITION_KINDS):
            raise ValueError(f"condition_order holds each of {', '.join(CONDITION_KINDS)} once")
        if self.distance_same_m > self.distance_changed_m:
            raise ValueError("distance_same_m is at most distance_changed_m, or a change could be none")


def training_rules(rules: Rules) -> Rules:
    """Return the rules of a training set, which has no maximum per person.

    Args:
        rules: Rules to change.
    """
    most = 1_000_000
    return msgspec.structs.replace(rules, max_per_person=most, max_per_person_in_all=most)


def rules_hash(rules: Rules | LoadRules) -> str:
    """Return a hash of the rules as 16 hexadecimal digits. Rules with different thresholds have different hashes.

    Args:
        rules: Rules.
    """
    return hashlib.sha256(msgspec.json.encode(rules, order="sorted")).hexdigest()[:16]


def rule_rows(rules: Rules | None = None) -> list[dict[str, Any]]:
    """List the rules.

    Args:
        rules: Rules, or None for the defaults.

    Returns:
        One row per rule: the name that `override` takes, the value and the meaning.
    """
    rules = rules or Rules()
    rows = []
    for prefix, group in (("", rules), ("load.", rules.load)):
        meanings = _meanings(type(group))
        for name in group.__struct_fields__:
            if name != "load":
                rows.append({"rule": f"{prefix}{name}", "value": getattr(group, name), "meaning": meanings[name]})
    return rows


def _meanings(kind: type[msgspec.Struct]) -> dict[str, str]:
    """Return the text below each field in the source."""
    (definition,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: " ".join(str(below.value.value).split())
        for field, below in pairwise(definition.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
    }


def override(rules: Rules, changes: Mapping[str, str]) -> Rules:
    """Change some rules.

    Args:
        rules: Rules to change.
        changes: New values by name. The name of a load rule is `load.name`. A value is JSON. A string needs no quotes.

    Returns:
        The changed rules.

    Raises:
        InputError: If a name is unknown, or a value has the wrong type.
    """
    plain: dict[str, Any] = msgspec.to_builtins(rules)
    for name, text in changes.items():
        part, _, key = name.rpartition(".")
        target = plain.get(part) if part else plain
        if not isinstance(target, dict) or key not in target or isinstance(target[key], dict):
            near = did_you_mean(name, (row["rule"] for row in rule_rows(rules)))
            raise InputError(f"there is no rule {name!r}{near} 'jrdb-avr rules list' shows all", field=name)
        try:
            target[key] = msgspec.json.decode(text.encode())
        except UnicodeError:
            raise InputError(f"rule {name}: {text!r} is not Unicode", field=name) from None
        except msgspec.DecodeError:
            # A string needs no quotes. If the rule is a number, the conversion below refuses the string.
            target[key] = text
    try:
        return msgspec.convert(plain, Rules)
    except msgspec.ValidationError as error:
        raise InputError(f"rules: {error}", field=str(error)) from None
