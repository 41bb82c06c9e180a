"""Monolithic: the model gets the panoramas of evenly spaced frames, and answers in a single call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from jrdb_avr.agent.methods.attempt import Attempt, ImageFrame, ParsedReply, on_panoramas
from jrdb_avr.agent.methods.requests import FixedContextMethod, panorama_parts
from jrdb_avr.agent.model.messages import Part
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Panorama, Prediction, Task


class Monolithic(FixedContextMethod):
    """The method `monolithic` with `n` panoramas."""

    name = "monolithic"
    stages: ClassVar = {"calls": 1, "retries": 1}

    def answer(self, task: Task) -> Prediction:
        """Answer in one call, or in two calls if the first reply cannot be read.

        Args:
            task: The question to answer.

        Returns:
            The prediction.
        """
        attempt = Attempt(task, self.chat, self.convention, self.prompts)
        return answer_from(attempt, attempt.panoramas(self.n), "monolithic")


def answer_from(attempt: Attempt, panoramas: Sequence[Panorama], prompt: str, facts: Sequence[Part] = ()) -> Prediction:
    """Answer from panoramas in one call, or in two calls if the first reply cannot be read.

    Args:
        attempt: The attempt.
        panoramas: The panoramas.
        prompt: The name of the prompt.
        facts: Further parts of the user message.

    Returns:
        The prediction.
    """
    return answer_pictures(attempt, on_panoramas(panoramas), (*panorama_parts(panoramas), *facts), prompt)


def answer_pictures(
    attempt: Attempt, image: ImageFrame, parts: Sequence[Part], prompt: str, **values: str
) -> Prediction:
    """Answer from pictures in one call, or in two calls if the first reply cannot be read.

    Args:
        attempt: The attempt.
        image: The pictures that the box may refer to.
        parts: The pictures with their metadata, and further parts of the user message.
        prompt: The name of the prompt.
        **values: Further values of the prompt.

    Returns:
        The prediction.
    """
    text, frames = attempt.mode_text, ", ".join(f"{frame:06d}" for frame in image.frames)
    stage = attempt.render(prompt, answer_form=text.form, answer_rule=text.rule, frames=frames, **values)
    kept = ParsedReply()

    def read(reply: Mapping[str, Any]) -> ParsedReply:
        nonlocal kept
        kept = attempt.parse_final(reply, image).over(kept)
        if kept.faults:
            raise DecodeError("; ".join(kept.faults))
        return kept

    try:
        schema = attempt.final_schema(image.frames)
        return attempt.prediction(attempt.ask_stage(parts, stage, schema, read))
    except DecodeError as error:
        return attempt.prediction(replace(kept, faults=(str(error),)))
