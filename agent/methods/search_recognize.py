"""Search, then recognize: propose a box of the person, refine it in one crop, choose the answer.

Three calls. The evidence is the refined box, whatever the last call replies. An unusable box ends the question as
invalid: nothing replaces it.
"""

from __future__ import annotations

from typing import ClassVar, Final

from jrdb_avr.agent.methods.attempt import (
    Attempt,
    FixedContextMethod,
    ImageFrame,
    ParsedReply,
    frame_list,
    on_crop,
    on_panoramas,
    panorama_messages,
    panorama_parts,
)
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Part, metadata_line, picture_of
from jrdb_avr.agent.model.prompts import mode_text, render
from jrdb_avr.schema.answers import Answer, Evidence
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Prediction, Task
from jrdb_avr.schema.panorama import center_angle

_BOX_SCHEMA: Final = decode.closed_object({"evidence_bboxes": decode.EVIDENCE_SCHEMA})


class SearchRecognize(FixedContextMethod):
    """The method `search-recognize` with `n` panoramas and one crop."""

    name = "search-recognize"
    stages: ClassVar = {"crops": 1, "calls": 3}

    def answer(self, task: Task) -> Prediction:
        """At most three calls: the first box that cannot be used ends the question as invalid."""
        attempt = Attempt(task, self.chat, self.convention)
        panoramas = attempt.panoramas(self.n)
        stage = "proposal"
        try:
            proposal = _propose(attempt, panoramas)
            stage = "refinement"
            # Rounded to a hundredth of a column, so that the prompt holds no rounding error of a sum.
            crop = attempt.look(proposal.frame, round(center_angle(proposal.box[0], proposal.box[2]), 3))
            refined = _refine(attempt, crop)
        except DecodeError as error:
            return attempt.invalid(f"{stage}: {error}")
        panorama = next(panorama for panorama in panoramas if panorama.frame_index == crop.frame_index)
        (answer,), faults = decode.read_each(lambda: _choose(attempt, panorama, crop, refined))
        return attempt.prediction(ParsedReply(answer, refined, faults))


def _propose(attempt: Attempt, panoramas: tuple[Panorama, ...]) -> Evidence:
    """The coarse box, in one of the panoramas."""
    stage = render("search_recognize_propose", frames=frame_list(panoramas))
    return _box(attempt, (*panorama_parts(panoramas), stage), on_panoramas(panoramas))


def _refine(attempt: Attempt, crop: Observation) -> Evidence:
    """The refined box, in the crop."""
    stage = render("search_recognize_refine", frame_id=crop.frame_id)
    return _box(attempt, (*_crop_parts(crop), stage), on_crop(crop))


def _choose(attempt: Attempt, panorama: Panorama, crop: Observation, refined: Evidence) -> Answer:
    """The answer, with the refined box as evidence."""
    question, sequence = attempt.task.question, attempt.task.sequence
    text = mode_text(question.answer_mode, sequence.frame_count)
    box = ", ".join(f"{value:.1f}" for value in refined.box)
    parts: tuple[Part, ...] = (
        *panorama_parts((panorama,)),
        *_crop_parts(crop),
        f"Refined box, stitched pixels: [{box}]",
        render("search_recognize_answer", answer_form=text.form, answer_rule=text.rule),
    )
    schema = decode.closed_object({"answer": decode.answer_schema(question.answer_mode, question.choices)})
    reply = attempt.ask_object(panorama_messages(attempt.task, parts), schema)
    return attempt.read_answer(decode.only_keys(reply, ("answer",), "the reply")["answer"])


def _box(attempt: Attempt, parts: tuple[Part, ...], ground: ImageFrame) -> Evidence:
    """The box that a call returns, in stitched pixels."""
    reply = attempt.ask_object(panorama_messages(attempt.task, parts), _BOX_SCHEMA)
    return attempt.read_evidence(decode.only_keys(reply, ("evidence_bboxes",), "the reply")["evidence_bboxes"], ground)


def _crop_parts(crop: Observation) -> tuple[Part, ...]:
    return (f"Crop: {metadata_line(crop)}", picture_of(crop))
