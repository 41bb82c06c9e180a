"""The inspect page: questions with their plans, timelines, proofs and pictures. Reviewers judge each question."""

from __future__ import annotations

import contextlib
import functools
import random
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.page import on_strip, picture_uri, readable, render, unit_of
from jrdb_avr.engine.pages.svg import PlanGraph
from jrdb_avr.engine.pages.timeline import Record, SequenceTables, timeline_rows
from jrdb_avr.engine.report.truth import refuse_imported
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, to_crop
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import QuestionRecord

_STRIP: Final = (2820, 360)
_AROUND: Final = (1880, 240)
"""Width and height in pixels of a panorama on the page (`_STRIP`), and of the panoramas one second earlier and later.

The sizes are small enough for a page of twenty questions, and large enough to see people when the page is zoomed.
"""

CLOSE_UP: Final = 220
"""Side in pixels of the square close-up of a person."""

_LEAST_CLOSE_UP: Final = 110.0
"""Minimum side, in stitched pixels, of the area that a close-up shows. It leaves surroundings around small people."""


# -- questions --------------------------------------------------------------------------------------------------------


def choose_questions(ids: Sequence[str], sample: int, seed: int) -> list[str]:
    """Draw questions at random. Return at most `sample` of the ids, in ascending order."""
    return sorted(random.Random(seed).sample(sorted(ids), min(sample, len(ids))))  # noqa: S311 - no secret


def inspect_questions(store: Store, ids: Sequence[str]) -> list[Inspected]:
    """Read everything that the page shows about questions, except pictures.

    Args:
        store: The store.
        ids: Ids of the questions.

    Returns:
        The questions, in the order of the ids.

    Raises:
        StoreError: If a table is missing.
    """
    refuse_imported(store, "look at them with 'jrdb-avr view'")
    *tables, infos = store.question_tables("questions", "answers", "sequences")
    questions, answers = (_by_id(table, ids) for table in tables)
    sequences = {row["sequence"]: row for row in infos.to_pylist()}
    # Consecutive questions mostly share a sequence. Only one is kept in memory, because its tables may be large.
    read: SequenceTables | None = None
    inspected = []
    for name in ids:
        record = QuestionRecord.read(questions[name], answers[name])
        if read is None or read.name != record.sequence:
            read = SequenceTables(store, record.sequence)
        inspected.append(Inspected(record, sequences[record.sequence], read))
    return inspected


def _by_id(table: pa.Table, ids: Sequence[str]) -> dict[str, dict[str, Any]]:
    chosen = table.filter(pc.is_in(table["question_id"], value_set=pa.array(list(ids), pa.string())))
    return {row["question_id"]: row for row in chosen.to_pylist()}


class Inspected:
    """A question with everything that the page shows about it.

    Attributes:
        record: The question with its answer and proofs.
        plan: The plan of the question.
        fps: Frames per second of the sequence.
        frame_count: Number of frames of the sequence.
        people: Track id of each person of the plan, by role. The role of a person is the id of the person's node.
        counted: Track id of each person that the answer counts and that the plan does not name, by role.
        moments: Frame of each time that the plan names, by the name of the time.
        annotated: Frame that the page shows for a time (see `nearest_annotated`), by the name of the time.
        decisive: The box that shows the answer. If the answer is a count, the first of the boxes that the answer needs.
        boxes: Boxes of people in each frame that the page shows, by frame. Each frame has a list of pairs. A pair is
            the role and the box of a person.
        around: Boxes one second before and after each frame that the page shows, by frame. For each frame, there are
            two pairs of the frame at that time and a list of boxes, like the lists in `boxes`.
        timeline: Rows of the timeline.
        visibility: Evidence for clear views in the sequence: "attributes", "geometry" or "nothing".
    """

    def __init__(self, record: QuestionRecord, info: Record, sequence: SequenceTables) -> None:
        self.record, self.plan = record, parse_plan(record.plan)
        self.fps, self.frame_count, self.visibility = info["fps"], info["frame_count"], sequence.visibility
        self.people = {node.id: record.bindings[node.id] for node in self.plan.nodes}
        self.moments = {name: frame for name, frame in record.bindings.items() if name not in self.people}
        at = {name: nearest_annotated(frame, sequence.frames, sequence.step) for name, frame in self.moments.items()}
        self.annotated = at
        # If the answer is a count, no box is decisive. The first needed box then shows the target at the first time.
        self.decisive = next((box for box in record.needed if box.decisive), record.needed[0])
        counted = [box for box in record.needed if box.node not in self.people]
        self.counted = {box.node: box.track for box in counted}
        tracks = self.people | self.counted
        sightings = {role: sequence.rows("sightings", "track", track) for role, track in tracks.items()}

        def boxes(roles: Iterable[str], frame: int) -> list[tuple[str, Box]]:
            rows = ((role, row) for role in roles for row in sightings[role] if row["frame"] == frame)
            return [(role, Box(*(row[side] for side in "xywh"))) for role, row in rows]

        displayed = sorted({*at.values(), self.decisive.frame, *(box.frame for box in counted)})
        self.boxes = {frame: boxes(self.people, frame) for frame in displayed}
        for box in counted:
            self.boxes[box.frame].append((box.node, Box(box.x, box.y, box.w, box.h)))
        second = round(self.fps)
        self.around = {
            frame: [(at, boxes(dict(displayed_boxes) | self.people, at)) for at in (frame - second, frame + second)]
            for frame, displayed_boxes in self.boxes.items()
        }
        self.timeline = [
            row
            for role in self.people
            for row in timeline_rows(role, self.plan, self.people, self.moments, sightings[role], sequence)
        ]


def nearest_annotated(frame: int, frames: Sequence[int], step: int) -> int:
    """Return the frame that the page shows for an event. If possible, this frame is annotated.

    Args:
        frame: Index of the frame of the event.
        frames: Indexes of the annotated frames.
        step: Number of frames from one annotated frame to the next.

    Returns:
        The nearest annotated frame if its distance is at most half of `step`, otherwise `frame`.
    """
    near = min(frames, key=lambda annotated: abs(annotated - frame), default=frame)
    return near if abs(near - frame) <= step // 2 else frame


# -- the page ---------------------------------------------------------------------------------------------------------


class View(NamedTuple):
    """A picture with the boxes of people.

    Attributes:
        title: Title of the picture.
        uri: Data URI of the picture.
        width: Width of the coordinate system of the boxes.
        height: Height of the coordinate system of the boxes.
        boxes: Boxes of people.
        missing: Reason why there is no picture, or an empty text.
        plate: Height of the plates that show the names of people.
        near: Close-ups of the people in a panorama.
        around: Pairs of a number and a picture. The picture is the panorama one second before (-1) or after (1).
    """

    title: str
    uri: str = ""
    width: int = 0
    height: int = 0
    boxes: Sequence[tuple[str, Box]] = ()
    missing: str = ""
    plate: float = 28.0
    near: tuple[View, ...] = ()
    around: Sequence[tuple[int, View]] = ()


def inspect_page(
    questions: Sequence[Inspected], observer: Observer, questions_sha256: str, advance: Callable[[int], None]
) -> str:
    """Render the inspect page.

    Args:
        questions: The questions.
        observer: Source of the pictures.
        questions_sha256: Hash of the questions file. The stored decisions refer to it.
        advance: Called with 1 after each question of the page is rendered.

    Returns:
        The HTML.
    """
    contents = []
    for question in questions:
        contents.append(_question(question, observer))
        advance(1)
    options = {
        name: sorted({str(getattr(question.record, name)) for question in questions})
        for name in ("family", "template", "sequence")
    }
    return render("inspect.html", questions=contents, options=options, sha256=questions_sha256)


def _question(question: Inspected, observer: Observer) -> dict[str, Any]:
    record, answer = question.record, decode_answer(question.record.answer_mode, question.record.answer)
    in_words = functools.partial(readable, record.answer_mode, choices=(), fps=question.fps, unit=unit_of(record.plan))
    # The answer of a proof is JSON, or the text of a choice if the question has choices.
    proofs = [(proof, proof.answer if record.choices else in_words(proof.answer)) for proof in record.proofs]
    return {
        "one": question,
        "choices": [{"text": text, "right": answer == Choice(index)} for index, text in enumerate(record.choices, 1)],
        "answer": "" if record.choices else in_words(record.answer),
        "graph": PlanGraph(question.plan),
        "roles": {role: index for index, role in enumerate(question.people)}
        | dict.fromkeys(question.counted, len(question.people)),
        "views": [_strip(question, frame, observer) for frame in question.boxes],
        "crop": _crop(question, observer),
        "proofs": proofs,
    }


def _strip(question: Inspected, frame: int, observer: Observer) -> View:
    title = f"frame {frame}, {frame / question.fps:.1f} s"
    if names := [_moment(question, name) for name, at in question.annotated.items() if at == frame]:
        title = f"{', '.join(names)}: {title}"
    if absent := question.people.keys() - {role for role, _ in question.boxes[frame]}:
        title += f"; no box of {', '.join(sorted(absent)).upper()}"
    try:
        image = observer.panorama(question.record.sequence, frame)
    except ObserveError as error:
        return View(title, missing=str(error))
    near = tuple(close_up(role, box, image, frame) for role, box in question.boxes[frame] if role in question.people)
    around = []
    for sign, (neighbour, boxes) in zip((-1, 1), question.around[frame], strict=True):
        # The panoramas before and after are optional, so a missing or broken panorama is left out.
        with contextlib.suppress(ObserveError):
            panorama = observer.panorama(question.record.sequence, neighbour)
            around.append((sign, _panorama(f"{sign:+d} s, frame {neighbour}", panorama, _AROUND, boxes)))
    return _panorama(title, image, _STRIP, question.boxes[frame])._replace(near=near, around=around)


def _panorama(title: str, image: Image, size: tuple[int, int], boxes: Iterable[tuple[str, Box]]) -> View:
    """Return a whole panorama with boxes. The boxes are given in stitched pixels."""
    framed = [(role, part) for role, box in boxes for part in on_strip(box, WIDTH)]
    return View(title, picture_uri(image, size), WIDTH, HEIGHT, framed)


def _moment(question: Inspected, name: str) -> str:
    """Return the name of a time. If the frame of the time is not annotated, the text also has this frame."""
    frame = question.moments[name]
    return name if frame == question.annotated[name] else f"{name} (frame {frame}, between two annotated)"


def close_up(role: str, box: Box, image: Image, frame: int) -> View:
    """Cut a square around a person out of a panorama. The square may cross the seam.

    Args:
        role: The role of the person in the plan.
        box: The box of the person in stitched pixels.
        image: The panorama (480, 3760, 3).
        frame: Index of the frame, for the title.

    Returns:
        The square picture with the box.
    """
    side = int(min(max(1.5 * max(box.w, box.h), _LEAST_CLOSE_UP), HEIGHT))
    left = int(box.x + box.w / 2 - side / 2)
    top = int(min(max(box.y + box.h / 2 - side / 2, 0), HEIGHT - side))
    cut = np.take(image, np.arange(left, left + side), axis=1, mode="wrap")[top : top + side]
    scale, size = CLOSE_UP / side, (CLOSE_UP, CLOSE_UP)
    framed = Box((box.x - left) * scale, (box.y - top) * scale, box.w * scale, box.h * scale)
    return View(f"{role.upper()} in frame {frame}", picture_uri(cut, size), *size, ((role, framed),), plate=24.0)


def _crop(question: Inspected, observer: Observer) -> View:
    needed = question.decisive
    frame, angle = needed.frame, float(center_angle(needed.x, needed.w))
    title = f"what answers it: {needed.node.upper()} in frame {frame}, angle {angle:.1f}\N{DEGREE SIGN}"
    try:
        observation = observer(question.record.sequence, frame, angle)
    except ObserveError as error:
        return View(title, missing=str(error))
    box = to_crop(Box(needed.x, needed.y, needed.w, needed.h), observation.left)
    return View(title, picture_uri(observation.image, (CROP, CROP)), CROP, CROP, ((needed.node, box),))
