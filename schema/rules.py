"""Every threshold of the benchmark, in one frozen object.

`LoadRules` shape the derived facts in the graph; their hash is stored with it, and questions are generated only from a
graph built under the same ones. `Rules` adds what generation uses; its hash stands in every row of `answers`. Times
are seconds where a person would say seconds; the code compares frames (`frames(seconds)`).
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
"""Frames between keyframes: one per second."""

SLACK: Final = 1e-9
"""Degrees or metres that a decimal such as 0.55 may miss the edge by that it names."""


def frames(seconds: float) -> int:
    """Frames in a span of seconds."""
    return round(seconds * FPS)


Pixels = Annotated[float, msgspec.Meta(ge=0, le=10_000)]
Metres = Annotated[float, msgspec.Meta(ge=0, le=1000)]
Seconds = Annotated[float, msgspec.Meta(ge=0, le=3600)]
Wait = Annotated[float, msgspec.Meta(ge=1, le=3600)]
"""Seconds between two times of a question: one keyframe step at least, or both would be the same time."""
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
    """Thresholds that make a fact true, false or unknown. `rule_rows` returns the text below a rule as its meaning.

    The margin of distances is so small that at most two distance words are possible for one distance.
    """

    gap_frames: Annotated[int, msgspec.Meta(ge=0, le=900)] = 7
    """Gaps of actions, memberships and relations up to this many frames are closed where the layer has every frame."""
    clear_min_width: Pixels = 12.0
    """A narrower box is no clear view."""
    clear_min_height: Pixels = 40.0
    """A lower box is no clear view."""
    clear_max_width: Pixels = 480.0
    """A wider box is no clear view: no crop holds it."""
    sector_true_deg: Annotated[float, msgspec.Meta(gt=0, le=45)] = 40.0
    """A robot sector is true of whoever is at most this far off its axis."""
    sector_false_deg: Annotated[float, msgspec.Meta(ge=45, lt=180)] = 90.0
    """A robot sector is false farther off its axis than this; in between some would say that it is true."""
    distance_margin: Annotated[float, msgspec.Meta(ge=0, le=0.33)] = 0.10
    """Relative margin round each bound of the distance words."""
    pair_max_m: Metres = 5.0
    """How far person-frame relations reach."""
    pair_margin_m: Metres = 0.5
    """This near to their reach person-frame relations are unknown: from 4.5 to 5.5 m."""
    pair_vertical_m: Metres = 1.35
    """People farther apart in height are on different floors or steps: their person-frame relation is unknown."""
    neighbor_max_deg: Annotated[float, msgspec.Meta(ge=0, le=180)] = 60.0
    """The first to the left or right is within this angle."""
    neighbor_margin_deg: Annotated[float, msgspec.Meta(ge=0, le=180)] = 1.0
    """Who is first to the left or right is unknown where somebody is nearer than this, or the next one follows so."""
    segment_min_s: Seconds = 2.0
    """Least length of a stable segment of an action."""
    segment_edge_s: Seconds = 1.0
    """Before a stable segment (and after a closed one) the action is false and the person present for this long."""
    segment_quiet_s: Seconds = 3.0
    """No other frame with the action true or unknown this near before or after a stable segment."""


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All thresholds of the benchmark. `load` has the thresholds that `load` applies."""

    load: LoadRules = LoadRules()
    condition_order: tuple[str, ...] = CONDITION_KINDS
    """Ties between descriptions of equal length go to the earlier kinds."""
    max_conditions: Annotated[int, msgspec.Meta(ge=1, le=3)] = 3
    """Most conditions of a description."""
    min_wait_s: Wait = 3.0
    """Least time from the description's time to the next time of a question, and between its later times."""
    long_wait_s: Wait = 10.0
    """Least time that long-range questions reach over."""
    search_wait_s: Wait = 2.0
    """Least time from the description to the start of the action for which a person found by hops is watched."""
    turn_deg: Annotated[float, msgspec.Meta(ge=0, lt=180)] = 20.0
    """A person watched for an action must have moved by more than this angle, as the robot sees it."""
    gap_min_s: Seconds = 5.0
    """Least time between two events where a question reads the seconds between them."""
    count_min: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 4
    """Fewest people that a question lets count."""
    shift_s: Wait = 3.0
    """How far time.shift moves the times of a question."""
    time_shift: Literal["either", "both"] = "either"
    """Which of the two shifts must change the answer: one is enough, or neither may leave it the same."""
    distance_changed_m: Metres = 1.5
    """Somebody is closer or farther who moved by this or more."""
    distance_same_m: Metres = 0.5
    """Somebody is about as far as before who moved by less; in between there is no question."""
    visible_share: Share = 0.5
    """A view shows a box when at least this share of its width lies inside."""
    near_duplicate_s: Seconds = 2.0
    """Of a person, one question of a template whose answer is read within this of every frame of another's."""
    near_presence_s: Seconds = 5.0
    """The same for the template presence."""
    max_per_person: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 12
    """Questions of one person and template."""
    max_per_person_in_all: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 24
    """Questions of one person."""
    max_answer_share: Share = 0.34
    """The most of one answer among the questions of a template with choices; at 1 no template has a limit."""

    def __post_init__(self) -> None:
        if sorted(self.condition_order) != sorted(CONDITION_KINDS):
            raise ValueError(f"condition_order holds each of {', '.join(CONDITION_KINDS)} once")
        if self.distance_same_m > self.distance_changed_m:
            raise ValueError("distance_same_m is at most distance_changed_m, or a change could be none")


def training_rules(rules: Rules) -> Rules:
    """The rules of a training set: no cap per person, and no limit on answers."""
    most = 1_000_000
    return msgspec.structs.replace(rules, max_per_person=most, max_per_person_in_all=most, max_answer_share=1.0)


def rules_hash(rules: Rules | LoadRules) -> str:
    """16 hex digits that change with any threshold."""
    return hashlib.sha256(msgspec.json.encode(rules, order="sorted")).hexdigest()[:16]


def rule_rows(rules: Rules | None = None) -> list[dict[str, Any]]:
    """A row per rule: the name that `override` takes, its value, and its meaning."""
    rules = rules or Rules()
    rows = []
    for prefix, group in (("", rules), ("load.", rules.load)):
        meanings = _meanings(type(group))
        for name in group.__struct_fields__:
            if name != "load":
                rows.append({"rule": f"{prefix}{name}", "value": getattr(group, name), "meaning": meanings[name]})
    return rows


def _meanings(kind: type[msgspec.Struct]) -> dict[str, str]:
    """The text that stands below each field in the source."""
    (definition,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: " ".join(str(below.value.value).split())
        for field, below in pairwise(definition.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
    }


def override(rules: Rules, changes: Mapping[str, str]) -> Rules:
    """Rules with `name=value` overrides applied; names of load rules are written `load.name`.

    A value is JSON; a word needs no quotes. Raises InputError for an unknown name or a value of the wrong type.
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
            # A word needs no quotes; one in the place of a number fails by its type below.
            target[key] = text
    try:
        return msgspec.convert(plain, Rules)
    except msgspec.ValidationError as error:
        raise InputError(f"rules: {error}", field=str(error)) from None
