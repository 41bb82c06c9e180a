"""The page of one question in `view`: frames with looks and boxes, the answers of runs, and the steps of one run."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from jrdb_avr.engine.pages.page import readable, render, unit_of
from jrdb_avr.engine.pages.trace import ROLES, evidence_box
from jrdb_avr.engine.report.traces import StoredRow, Trace, Transcript, Written
from jrdb_avr.engine.report.truth import read_answer
from jrdb_avr.queries.questions import QuestionRow
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.beliefs import ALWAYS
from jrdb_avr.schema.method import SequenceInfo
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, Box
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.wording.text import moment, parse, stated_frames

_LONGEST: Final = 4_000
"""Maximum number of characters of a step's text. The page `trace` shows longer texts."""

_MOST: Final = 3_000
"""Maximum number of beliefs, of refused writes and of steps on a page. Built-in methods have fewer of each."""


class Asked(NamedTuple):
    """A question as the page shows it.

    Attributes:
        question: The question.
        parts: Pieces of the text. The pieces at odd positions are the times that only this one of two twins states.
        right: Number of the right choice. None if the answer is not a choice or may not be shown.
        given: Number of the choice that the shown run gave, or None.
    """

    question: QuestionRow
    parts: Sequence[str]
    right: int | None
    given: int | None


class Belief(NamedTuple):
    """A statement of the world model and its evidence.

    Attributes:
        person: Name of the entity that the statement is about.
        role: Number of the entity's colour.
        text: The statement.
        step: Number of the step that wrote the statement.
        until: Number of the step that replaced the statement. None if the statement still holds.
        frame: Frame of the evidence, or None if there is no single frame.
        look: Number of the step that made the look with the evidence, or None if the look is unknown.
        votes: Number of readings that agree with the statement, and number of readings that contradict it.
    """

    person: str
    role: int
    text: str
    step: int
    until: int | None
    frame: int | None
    look: int | None
    votes: tuple[int, int]


def question_page(
    question: QuestionRow,
    info: SequenceInfo,
    runs: Sequence[Any],
    chosen: Any | None,
    transcript: Transcript | None,
    twin: tuple[QuestionRow, str, str] | None,
    missing: str,
    near: Sequence[QuestionRow | None],
    pictured: bool,
    address: Callable[..., str],
) -> str:
    """Render the page of one question.

    Args:
        question: The question.
        info: The sequence of the question.
        runs: The runs (`ViewedRun`) that have the question.
        chosen: The run to show in detail, or None.
        transcript: Record of the chosen run's work on the question. None if there is no transcript. If scores may be
            shown, the record is a `Trace`.
        twin: The time twin of the question, the twin's true answer as JSON, and the question's own. None without a
            twin, or if the page may not show true answers.
        missing: Reason why there is no transcript, or an empty text.
        near: The previous and the next question of the store. None stands for a question that does not exist.
        pictured: Whether the panoramas of the store are available.
        address: The function `view.address`, which returns the address of a page.

    Returns:
        The HTML.
    """
    trace = transcript if isinstance(transcript, Trace) else None
    true = None if trace is None else trace.answer["answer"]
    unit = "" if trace is None else unit_of(parse_plan(trace.answer["plan"]))
    mode, fps = question.answer_mode, info.fps
    given = {run.name: readable(mode, _answer(run, question), question.choices, fps, unit) for run in runs}
    if twin is None:
        asked = [_asked(question, true, None, chosen)]
    else:
        asked = [_asked(question, twin[2], twin[0], chosen), _asked(twin[0], twin[1], question, chosen)]
    return render(
        "view_question.html",
        question=question,
        asked=asked,
        info=info,
        runs=runs,
        chosen=chosen,
        given=given,
        right_text=readable(mode, true, question.choices, fps, unit),
        beliefs=[] if transcript is None else beliefs(transcript.writes)[:_MOST],
        refused=[] if transcript is None else transcript.refused[:_MOST],
        steps=[] if transcript is None else [_step(step, transcript) for step in transcript.steps[:_MOST]],
        looks=[] if transcript is None else transcript.looks,
        scene=scene(info, transcript),
        scored=trace is not None,
        missing=missing,
        near=near,
        pictured=pictured,
        at=address,
    )


def _asked(question: QuestionRow, true: str | None, twin: QuestionRow | None, run: Any | None) -> Asked:
    given = None if run is None else _answer(run, question)
    right, answered = (read_answer(question.answer_mode, answer) for answer in (true, given))
    numbers = (answer.choice if isinstance(answer, Choice) else None for answer in (right, answered))
    return Asked(
        question, [question.question] if twin is None else split_times(question.question, twin.question), *numbers
    )


def split_times(text: str, twin: str) -> list[str]:
    """Split the text of a question at the times that its time twin does not state.

    Args:
        text: The text of the question.
        twin: The text of the twin.

    Returns:
        The pieces in order. The pieces at odd positions are the times.
    """
    stated, stated_by_twin = (set(map(moment, stated_frames(parse(asked)[1]))) for asked in (text, twin))
    return re.split(f"({'|'.join(map(re.escape, sorted(stated - stated_by_twin)))})", text)


def _answer(run: Any, question: QuestionRow) -> str | None:
    row: StoredRow = run.predictions.get(question.question_id, {})
    return row.get("answer")


def scene(info: SequenceInfo, transcript: Transcript | None) -> dict[str, Any]:
    """Return the input of the script that draws boxes and looks on panoramas.

    Args:
        info: The sequence.
        transcript: Record of the shown run, or None.

    Returns:
        Facts about the sequence, the frame to start with (`start`), the boxes in stitched pixels (`boxes`), and the
        looks with the columns that they show (`looks`). Each box and each look has its frame.
    """
    scene_data: dict[str, Any] = {"sequence": info.sequence, "fps": info.fps, "frames": info.frames}
    scene_data |= {"width": WIDTH, "height": HEIGHT, "start": info.frames[0] if info.frames else 0}
    boxes: list[dict[str, Any]] = []
    looks: list[dict[str, Any]] = []
    if transcript is not None:
        looks = [{"frame": look.frame, "step": look.step, "spans": look.spans} for look in transcript.looks]
        boxes += _sightings(transcript.writes)
        if isinstance(transcript, Trace):
            boxes += [
                _drawn(Box(*sides), frame, "target", "target") for frame, sides in sorted(transcript.target.items())
            ]
        if (given := evidence_box(transcript)) is not None:
            boxes.append(_drawn(given[1], given[0], "given", "box of the run"))
        scene_data["start"] = given[0] if given is not None else looks[0]["frame"] if looks else scene_data["start"]
    return scene_data | {"boxes": boxes, "looks": looks}


def _drawn(box: Box, frame: int, kind: str, name: str) -> dict[str, Any]:
    return {"frame": frame, "box": list(box), "kind": kind, "name": name[:40]}


def _names(writes: Sequence[Written]) -> dict[str, tuple[str, int]]:
    """Return a dict from the key of each entity to the entity's name and the number of its colour."""
    made = [write.fact.entity for write in writes if write.fact.entity is not None]
    return {entity.id: (entity.name, index % ROLES) for index, entity in enumerate(made)}


def _sightings(writes: Sequence[Written]) -> list[dict[str, Any]]:
    names, boxes = _names(writes), []
    for write in writes:
        if (sighting := write.fact.sighted) is not None and sighting.source in names:
            name, role = names[sighting.source]
            boxes.append(_drawn(sighting.box, sighting.frame, f"role{role}", name))
    return boxes


def beliefs(writes: Sequence[Written]) -> list[Belief]:
    """Return the statements that a run has written to a world model.

    Args:
        writes: The changes that the run made to the world model, in order.

    Returns:
        The statements in the order of the changes. Each statement has its evidence.
    """
    names = _names(writes)
    taken = {write.fact.observation.id: write.fact.observation for write in writes if write.fact.observation}
    statements = []
    for write in writes:
        fact = write.fact
        until = None if write.until == ALWAYS else write.until
        rows: list[tuple[str, str, int | None, str, tuple[int, int]]] = []
        if (sighting := fact.sighted) is not None:
            votes = (sighting.votes, sighting.against)
            rows.append(
                (sighting.source, f"at {sighting.angle:.0f}\N{DEGREE SIGN}", sighting.frame, sighting.target, votes)
            )
        if (has := fact.has) is not None:
            frame = has.first if has.first == has.last else None
            rows.append((has.source, f"{has.name}: {has.value}", frame, has.target, (has.votes, has.against)))
        if (tie := fact.related) is not None:
            text = f"{tie.name} \N{RIGHTWARDS ARROW} {names.get(tie.target, ('?', 0))[0]}"
            rows.append((tie.source, text, tie.first, tie.observation, (tie.votes, tie.against)))
        for entity, text, frame, observation, votes in rows:
            look = taken.get(observation)
            at = frame if frame is not None or look is None else look.frame
            person, role = names.get(entity, ("?", 0))
            statements.append(
                Belief(person, role, text, write.step, until, at, None if look is None else look.step, votes)
            )
    return statements


def _step(step: StoredRow, transcript: Transcript) -> dict[str, Any]:
    look = next((candidate for candidate in transcript.looks if candidate.step == step["step"]), None)
    return {**step, "look": look, **{name: _cut(step[name] or "") for name in ("request", "response")}}


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}\n[{len(text) - _LONGEST} characters left out]"
