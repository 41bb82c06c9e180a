"""Turns of a run: the steps from one model call to the next, and what a world model stated and decided in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any, Final, NamedTuple

import msgspec

from jrdb_avr.engine.report.traces import Look, StoredRow, Transcript, Written
from jrdb_avr.schema.beliefs import ALWAYS, name_of
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Plan, parse_plan

_LONGEST: Final = 20_000
"""Maximum number of characters of a text. The middle of a longer text is left out."""

_ASIDE_DEG: Final = 10.0
"""Maximum angle in degrees between a look that was due and the look that was made."""

ROLES: Final = 6
"""Number of colours of people in `roles.css`."""

_NAMES: Final = 4
"""Maximum number of new people that a title names, and of looks that it lists."""


class _Reply(msgspec.Struct):
    content: str = ""
    reasoning: str = ""
    finish_reason: str = ""


class _Message(msgspec.Struct):
    """A message of a chat, as text."""

    role: str
    content: str


class Binding(msgspec.Struct):
    """People of the world model as nodes of the plan, with their summed log-odds.

    `margin` is the distance to the best binding with another target, in log-odds. None if it was not recorded.
    """

    nodes: dict[str, str]
    log_odds: float
    margin: float | None = None


class GraphState(msgspec.Struct):
    """The line `World` of a prompt: likely bindings, open parts of the plan, and the supported answer."""

    likely: list[Binding] = []
    open: list[str] = []
    supported: Any = None


class AdvisedLook(msgspec.Struct):
    """A look of the line `Looks` of a prompt. `angle_deg` is the panorama angle in degrees."""

    frame_id: str
    angle_deg: float
    reason: str = ""

    @property
    def words(self) -> str:
        """The frame and the angle in words."""
        return f"frame {self.frame_id.lstrip('0') or 0}, {self.angle_deg:g}\N{DEGREE SIGN}"


class PlanPartRow(msgspec.Struct):
    """A part of the plan, and its support in log-odds and its state (such as "open") under each binding."""

    part: str
    support: list[tuple[float, str]]


class StatementRun(msgspec.Struct):
    """A statement over the world model: its name in `queries`, its parameters, and the rows that it returned."""

    name: str
    parameters: Any
    rows: list[dict[str, Any]]


class Conclusion(msgspec.Struct):
    """The answer that the world model supports: its person, the frame of the evidence, the verdict, and the reason."""

    entity: str
    frame: int
    verdict: str
    support: str = ""


class GraphDecision(msgspec.Struct):
    """The end of a question that a world model decided, as the run recorded it."""

    bindings: list[Binding]
    conclusion: Conclusion | None = None
    parts: list[PlanPartRow] = []
    statements: list[StatementRun] = []


class Call(NamedTuple):
    """A call of a tool: tool and arguments in words, the result, and whether the call was refused."""

    text: str
    result: str
    refused: bool


class PersonLine(NamedTuple):
    """What a turn wrote about a person: the key of the entity, whether it is new, and the facts in words."""

    entity: str
    new: bool
    facts: list[str]


@dataclass(frozen=True)
class Turn:
    """A model call and the steps up to the next model call.

    Attributes:
        title: What the turn did.
        step: Index of the first step.
        seconds: Duration of all steps.
        texts: Steps as texts, without looks and calls of tools.
        graph: What the prompt stated about the world model, or None.
        advised: Looks that the prompt advised.
        calls: Calls of tools.
        people: What the turn wrote about each person.
        looks: Looks of the turn.
        refused: Rows of refused writes with a reason that is not in the result of a call.
    """

    title: str
    step: int
    seconds: float
    texts: Sequence[dict[str, Any]]
    graph: GraphState | None
    advised: Sequence[AdvisedLook]
    calls: Sequence[Call]
    people: Sequence[PersonLine]
    looks: Sequence[Look]
    refused: Sequence[StoredRow]


def turns_of(transcript: Transcript) -> list[Turn]:
    """Group the steps of a run into turns.

    Args:
        transcript: Record of the run's work on a question.

    Returns:
        The turns. If steps precede the first model call, the first element holds these steps.
    """
    turns: list[Turn] = []
    groups: list[list[StoredRow]] = []
    for step in transcript.steps:
        if step["kind"] == "model" or not groups:
            groups.append([])
        groups[-1].append(step)
    number = 0
    for group, after in zip_longest(groups, groups[1:]):
        steps = range(group[0]["step"], after[0]["step"] if after else ALWAYS)
        writes = [write for write in transcript.writes if write.step in steps]
        looks = [look for look in transcript.looks if look.step in steps]
        calls = [_call(step) for step in group if step["kind"] == "tool"]
        graph, advised = _stated(group[0])
        people = _people(writes)
        solved = [step["response"] for step in group if step["kind"] == "solve"]
        due = [look for text in solved for look in _decoded(text, list[AdvisedLook]) or []]
        number += group[0]["kind"] == "model"
        head = f"Turn {number}" if number else "Before the first turn"
        ended = after is None and transcript.prediction["status"] == "answered"
        did = ", ".join(_deeds(writes, _looked(looks, due), calls, people)) or ("answered" if ended else "replied")
        results = " ".join(call.result for call in calls)
        refused = [row for row in (write.row for write in writes) if row["reason"] and row["reason"] not in results]
        shown = {look.step for look in looks}
        texts = [_texts(step) for step in group if step["kind"] != "tool" and step["step"] not in shown]
        seconds = sum(step["seconds"] for step in group)
        turns.append(Turn(f"{head}: {did}", steps.start, seconds, texts, graph, advised, calls, people, looks, refused))
    return turns


def entity_roles(transcript: Transcript) -> dict[str, int]:
    """Return the number of the colour of each entity of the world model, by name, in the order of creation."""
    made = [entity.name for write in transcript.writes for entity in write.fact.entities]
    return {name: index % ROLES for index, name in enumerate(made)}


def plan_of(transcript: Transcript) -> Plan | None:
    """Return the plan that the run wrote to its world model, or None."""
    plans = [write.row["arguments"] for write in transcript.writes if write.fact.slots]
    try:
        return parse_plan(plans[-1]) if plans else None
    except PlanError:
        return None


def decision_of(transcript: Transcript) -> GraphDecision | None:
    """Return the last recorded decision of the world model, or None."""
    texts = [step["response"] for step in transcript.steps if step["kind"] == "solve"]
    return next((found for text in reversed(texts) if (found := _decoded(text, GraphDecision))), None)


def _stated(step: StoredRow) -> tuple[GraphState | None, list[AdvisedLook]]:
    """Return what the last message of a model call stated about the world model, and the looks that it advised."""
    messages = _decoded(step["request"], list[_Message]) if step["kind"] == "model" else None
    lines = messages[-1].content.splitlines() if messages else []
    stated = {name: text for name, _, text in (line.partition(": ") for line in lines)}
    return _decoded(stated.get("World", ""), GraphState), _decoded(stated.get("Looks", ""), list[AdvisedLook]) or []


def _call(step: StoredRow) -> Call:
    """Return the call of a tool that a step records. Long arguments are counted, not shown."""
    call, result = _decoded(step["request"], dict[str, Any]), _decoded(step["response"], str)
    if outcome := _decoded(step["response"], dict[str, str]):
        # The outcome of a plan has the plan, which is drawn, or the reason of the refusal.
        result = f"refused: {outcome['refused']}" if "refused" in outcome else ", ".join(outcome)
    if not call or result is None:
        return Call(step["request"], step["response"], "refused" in step["response"][:20])
    tool = call.pop("tool", "")
    words = (f"{len(value)} {key}" if isinstance(value, list) else f"{key} {value}" for key, value in call.items())
    return Call(f"{tool} {', '.join(words)}", result, result.startswith("refused"))


def _deeds(
    writes: Sequence[Written], looks: Sequence[str], calls: Sequence[Call], people: Sequence[PersonLine]
) -> Iterator[str]:
    """Yield what a turn did, in a few words each."""
    if any(write.row["tool"] == "plan" and write.row["accepted"] for write in writes):
        yield "wrote the plan"
    if people:
        new = [person.entity for person in people if person.new]
        names = f" ({', '.join(new)} new)" if 0 < len(new) <= _NAMES else f" ({len(new)} new)" if new else ""
        yield f"wrote {len(people)} {'person' if len(people) == 1 else 'people'}{names}"
    yield from looks if len(looks) <= _NAMES else [f"looked {len(looks)} times"]
    finals = [call for call in calls if call.text.startswith("final_answer")]
    yield from (f"final answer {'refused' if call.refused else 'accepted'}" for call in finals)
    if refused := sum(not write.row["accepted"] for write in writes if write.row["tool"] != "final_answer"):
        yield f"{refused} refused"


def _looked(looks: Sequence[Look], due: Sequence[AdvisedLook]) -> list[str]:
    """Return the looks of a turn in words. `due` are the looks that were due after the turn's writes.

    A look that was due has a reason. Looks at the same frame for the same reason share a text.
    """
    angles: dict[tuple[int, str], list[str]] = {}
    for look in looks:
        # A look that repeats an earlier look is turned aside by a few degrees.
        near = (
            f" ({advised.reason})"
            for advised in due
            if advised.frame_id == f"{look.frame:06d}"
            and angle_error(advised.angle_deg, look.angle or 0.0) < _ASIDE_DEG
        )
        angles.setdefault((look.frame, next(near, "")), []).append(_angle(look))
    return [f"looked at frame {frame}, {' and '.join(words)}{why}" for (frame, why), words in angles.items()]


def _angle(look: Look) -> str:
    return "the whole panorama" if look.angle is None else f"{look.angle:.0f}\N{DEGREE SIGN}"


def look_words(look: Look) -> str:
    """Return the frame and the angle of a look in words."""
    return f"frame {look.frame}, {_angle(look)}"


def _people(writes: Sequence[Written]) -> list[PersonLine]:
    """Return what accepted writes state about each person, in the order of the writes."""
    people: dict[str, PersonLine] = {}

    def line(key: str, new: bool = False) -> list[str]:
        return people.setdefault(name_of(key), PersonLine(name_of(key), new, [])).facts

    for fact in (write.fact for write in writes):
        for entity in fact.entities:
            line(entity.id, new=True)
        for sighting in fact.sighted:
            line(sighting.source)
        for has in fact.has:
            if has.origin == "model":
                line(has.source).append(f"{has.name} {has.value} {has.weight:+.1f}")
        for tie in fact.related:
            # What follows from boxes is shown only for people of the turn, and only if it holds.
            if tie.origin == "model" or (tie.weight > 0 and name_of(tie.source) in people):
                text = f"{tie.name} \N{RIGHTWARDS ARROW} {name_of(tie.target)} {tie.weight:+.1f}"
                line(tie.source).append(text if tie.origin == "model" else f"{text} (from boxes)")
    return list(people.values())


def _texts(step: StoredRow) -> dict[str, Any]:
    """Return a step with its request and its response as texts. `short` texts fit side by side."""
    of_model = step["kind"] == "model"
    request = _messages(step["request"]) if of_model else plain_text(step["request"])
    response = _reply(step["response"]) if of_model else plain_text(step["response"])
    short = not of_model and max(len(request), len(response)) <= 160 and "\n" not in request + response
    return {**step, "request": request, "response": response, "short": short}


# -- texts of models, which may contain anything -----------------------------------------------------------------------


def _messages(text: str) -> str:
    """Return the messages to a model as text. Images are represented by their names."""
    messages = _decoded(text, list[_Message])
    return _cut(text if messages is None else "\n\n".join(f"[{one.role}]\n{one.content}" for one in messages))


def _reply(text: str) -> str:
    reply = _decoded(text, _Reply)
    if reply is None:
        return _cut(text)
    thought = f"[reasoning]\n{_cut(reply.reasoning)}\n\n" if reply.reasoning else ""
    ended = "" if reply.finish_reason in ("", "stop") else f"\n[finish_reason {reply.finish_reason}]"
    return f"{thought}{plain_text(reply.content)}{ended}"


def plain_text(text: str | None) -> str:
    """Indent a long JSON text, including JSON objects inside its strings.

    Args:
        text: A text of a model or of a run.

    Returns:
        The indented JSON. Other texts are returned without indents. The middle of a very long text is left out.
    """
    if not text or len(text) <= 100:
        return text or ""
    value = _decoded(text)
    if isinstance(value, dict):
        inner = {name: isinstance(item, str) and item.startswith("{") for name, item in value.items()}
        value = {name: (_decoded(item) or item) if inner[name] else item for name, item in value.items()}
    try:
        return _cut(text if value is None else msgspec.json.format(msgspec.json.encode(value), indent=1).decode())
    except (UnicodeError, RecursionError):
        return _cut(text)


def _decoded(text: str, kind: Any = Any) -> Any:
    """Return the value of a JSON text, or None if the text is not JSON of the type `kind`."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return None


def _cut(text: str) -> str:
    half, more = _LONGEST // 2, len(text) - _LONGEST
    return text if more <= 0 else f"{text[:half]}\n[{more} characters left out]\n{text[-half:]}"
