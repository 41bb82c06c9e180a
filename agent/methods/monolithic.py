"""Monolithic: one call that gets evenly spaced panoramas and answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from jrdb_avr.agent.methods.attempt import (
    Attempt,
    FixedContextMethod,
    final_parts,
    frame_list,
    on_panoramas,
    panorama_messages,
    panorama_parts,
)
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Part
from jrdb_avr.agent.model.prompts import mode_text, render
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Panorama, Prediction, Task


class Monolithic(FixedContextMethod):
    """The method `monolithic` with `n` panoramas."""

    name = "monolithic"
    stages: ClassVar = {"calls": 1}

    def answer(self, task: Task) -> Prediction:
        """One call; what cannot be read of its reply is invalid."""
        attempt = Attempt(task, self.chat, self.convention)
        return answer_from(attempt, attempt.panoramas(self.n), "monolithic")


def answer_from(attempt: Attempt, panoramas: Sequence[Panorama], prompt: str, known: Sequence[Part] = ()) -> Prediction:
    """The call that answers from panoramas and what is `known` beside them, and the prediction that it makes."""
    task = attempt.task
    text = mode_text(task.question.answer_mode, task.sequence.frame_count)
    stage = render(prompt, answer_form=text.form, answer_rule=text.rule, frames=frame_list(panoramas))
    messages = panorama_messages(task, (*panorama_parts(panoramas), *known, stage))
    try:
        reply = attempt.ask_object(messages, decode.closed_object(final_parts(task.question)))
        return attempt.prediction(attempt.parse_final(reply, on_panoramas(panoramas)))
    except DecodeError as error:
        return attempt.invalid(str(error))
