"""Search, then recognize: propose a person's box, refine the box in one crop, and choose the answer.

Each of the three stages is one call, or two calls if the first reply cannot be used. The evidence is the refined box,
or the proposed box if the second stage gives no usable box. If there is no proposed box, the method answers from the
panoramas with the prompt of `monolithic`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from jrdb_avr.agent.methods.attempt import Attempt, ImageFrame, ParsedReply, on_crop, on_panoramas
from jrdb_avr.agent.methods.monolithic import answer_from
from jrdb_avr.agent.methods.requests import FixedContextMethod, frame_list, panorama_parts
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Part, metadata_line, picture_of
from jrdb_avr.agent.model.schemas import evidence_schema, frame_schema
from jrdb_avr.schema.answers import Answer, Evidence
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Prediction, Task
from jrdb_avr.schema.panorama import center_angle


class SearchRecognize(FixedContextMethod):
    """The method `search-recognize` with `n` panoramas and one crop."""

    name = "search-recognize"
    stages: ClassVar = {"crops": 1, "calls": 3, "retries": 1}

    def answer(self, task: Task) -> Prediction:
        """Propose a box, refine the box, and answer.

        Args:
            task: The question to answer.

        Returns:
            The prediction.
        """
        attempt = Attempt(task, self.chat, self.convention, self.prompts)
        panoramas = attempt.panoramas(self.n)
        shown = on_panoramas(panoramas)
        stage = attempt.render("search_recognize_propose", frames=frame_list(panoramas))
        try:
            proposal = _box(attempt, panorama_parts(panoramas), stage, shown)
        except DecodeError:
            return answer_from(attempt, panoramas, "monolithic")
        # The angle is rounded to 0.001 degrees (0.01 columns), because the prompt must not show rounding errors.
        crop = attempt.look(proposal.frame, round(center_angle(proposal.box[0], proposal.box[2]), 3))
        stage = attempt.render("search_recognize_refine", frame_id=f"{crop.frame_index:06d}")
        try:
            refined = _box(attempt, _crop_parts(crop), stage, on_crop(crop))
        except DecodeError:
            refined = proposal
        panorama = next(panorama for panorama in panoramas if panorama.frame_index == crop.frame_index)
        (answer,), faults = decode.read_each(lambda: _choose(attempt, panorama, crop, refined, shown.frames))
        return attempt.prediction(ParsedReply(answer, refined, faults))


def _choose(attempt: Attempt, panorama: Panorama, crop: Observation, refined: Evidence, shown: Sequence[int]) -> Answer:
    """Make the model call that answers the question, and return the answer. The request states the refined box."""
    text = attempt.mode_text
    box = ", ".join(f"{value:.1f}" for value in refined.box)
    parts: tuple[Part, ...] = (
        *panorama_parts((panorama,)),
        *_crop_parts(crop),
        f"Refined box, stitched pixels: [{box}]",
    )
    frames = ", ".join(f"{frame:06d}" for frame in shown)
    stage = attempt.render(
        "search_recognize_answer",
        answer_form=text.form,
        answer_rule=text.rule,
        frame_id=f"{refined.frame:06d}",
        frames=frames,
    )
    schema = decode.closed_object({"answer": attempt.answer_schema(shown)})
    return attempt.ask_stage(parts, stage, schema, lambda reply: attempt.read_answer(_only(reply, "answer")))


def _box(attempt: Attempt, parts: tuple[Part, ...], stage: str, image: ImageFrame) -> Evidence:
    """Make the model call of a stage that requests a box. Return the box as evidence in stitched pixels."""
    schema = decode.closed_object({"evidence_bboxes": evidence_schema(frame_schema(image.frames))})
    return attempt.ask_stage(
        parts, stage, schema, lambda reply: attempt.read_evidence(_only(reply, "evidence_bboxes"), image)
    )


def _only(reply: dict[str, Any], key: str) -> Any:
    return decode.only_keys(reply, (key,), "the reply")[key]


def _crop_parts(crop: Observation) -> tuple[Part, ...]:
    return (f"Crop: {metadata_line(crop)}", picture_of(crop))
