"""Monolithic: one call that is shown evenly spaced panoramas and answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jrdb_avr.agent.methods.attempt import (
    PANORAMAS,
    Attempt,
    final_parts,
    fixed_settings,
    frame_list,
    on_panoramas,
    panorama_messages,
    panorama_parts,
    shared_settings,
)
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.messages import Part
from jrdb_avr.agent.model.prompts import mode_text, render
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Panorama, Prediction, Task


@dataclass(frozen=True)
class Monolithic:
    """The method `monolithic` with `n` panoramas."""

    chat: Chat
    convention: Convention = CONTRACT
    n: int = PANORAMAS

    @property
    def name(self) -> str:
        return "monolithic"

    def settings(self) -> dict[str, Any]:
        """What the manifest of a run says of the method."""
        return {**fixed_settings(self.n), "calls": 1, **shared_settings(self.convention)}

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
        return attempt.ended(attempt.judge(reply, on_panoramas(panoramas)))
    except DecodeError as error:
        return attempt.invalid(str(error))
