"""The page of one question in `view`: frames with looks and boxes, the answers of runs, and the steps of one run."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from jrdb_avr.engine.pages.page import readable, render, unit_of
from jrdb_avr.engine.pages.trace import evidence_box
from jrdb_avr.engine.pages.turns import entity_roles, turns_of
from jrdb_avr.engine.report.traces import StoredRow, Trace, Transcript
from jrdb_avr.engine.report.truth import read_answer
from jrdb_avr.queries.questions import QuestionRow
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.beliefs import name_of
from jrdb_avr.schema.method import SequenceInfo
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, Box
from jrdb_avr.schema.wording.text import moment, parse, stated_frames

_MOST: Final = 1_000
"""Maximum number of turns on a page. Built-in methods have fewer."""


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


def question_page(
    question: QuestionRow,
    info: SequenceInfo,
    chosen: Any | None,
    transcript: Transcript | None,
    twin: tuple[QuestionRow, str, str] | None,
    truth: StoredRow | None,
    **shown: Any,
) -> str:
    """Render the page of one question.

    Args:
        question: The question.
        info: The sequence of the question.
        chosen: The run to show in detail, or None.
        transcript: Record of the chosen run's work on the question. None if there is no transcript. If scores may be
            shown, the record is a `Trace`.
        twin: The time twin of the question, the twin's true answer as JSON, and the question's own. None without a
            twin, or if the page may not show true answers.
        truth: Row of the question in the table `answers`. None if the page may not show true answers.
        shown: Further values of the template: the runs that have the question (`runs`), the reason why there is no
            transcript (`missing`), the previous and the next question or None (`near`), whether the store has
            panoramas (`pictured`), and the function `view.address` (`at`).

    Returns:
        The HTML.
    """
    true = None if truth is None else truth["answer"]
    unit = "" if truth is None else unit_of(truth["plan"])
    mode, fps = question.answer_mode, info.fps
    given = {run.name: readable(mode, _answer(run, question), question.choices, fps, unit) for run in shown["runs"]}
    if twin is None:
        asked = [_asked(question, true, None, chosen)]
    else:
        asked = [_asked(question, twin[2], twin[0], chosen), _asked(twin[0], twin[1], question, chosen)]
    return render(
        "view_question.html",
        question=question,
        asked=asked,
        info=info,
        chosen=chosen,
        given=given,
        right_text=readable(mode, true, question.choices, fps, unit),
        roles={} if transcript is None else entity_roles(transcript),
        turns=[] if transcript is None else turns_of(transcript)[:_MOST],
        scene=scene(info, transcript),
        scored=isinstance(transcript, Trace),
        **shown,
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
        roles = entity_roles(transcript)
        for seen in (sighting for write in transcript.writes for sighting in write.fact.sighted):
            name = name_of(seen.source)
            boxes.append(_drawn(seen.box, seen.frame, f"role{roles.get(name, 0)}", name))
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
