"""ReAct: the model looks, thinks, looks again, and answers. Every turn sends the history of looks again.

The rules are the rules of `Episode`, and each turn is a move of an episode. After a malformed turn, the next turn
states the error. Each request has all earlier crops, or only the newest crops, with their metadata. Servers may
therefore be stateless, and a finished call can be repeated from its request alone.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from jrdb_avr.agent.methods.attempt import DUPLICATE_DEG
from jrdb_avr.agent.methods.episode import BUDGET, Episode, most_moves
from jrdb_avr.agent.methods.requests import history_settings, shared_settings
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.messages import (
    Message,
    Part,
    Picture,
    metadata_line,
    metadata_of,
    picture_of,
    with_last_pictures,
)
from jrdb_avr.agent.model.prompts import PromptSet
from jrdb_avr.agent.model.schemas import frame_schema
from jrdb_avr.schema.errors import RefusedError
from jrdb_avr.schema.method import Observation, Prediction, Task

IDENTICAL: Final = 3
"""Number of identical refusals in sequence after which a turn must answer. A model that repeats a move goes on so."""


@dataclass(frozen=True)
class ReAct:
    """The method `react`. With a maximum of N looks, it makes at most 2 N + 2 model calls.

    history: the number of newest crops that a turn sends. None sends all crops. For older crops, a turn sends the
    metadata without the picture.
    """

    name: ClassVar = "react"

    chat: Chat
    convention: Convention = CONTRACT
    budget: int = BUDGET
    history: int | None = None
    prompts: PromptSet = "default"

    def settings(self) -> dict[str, Any]:
        """Return the method's settings for a run's manifest."""
        return {
            "budget": self.budget,
            "most_calls": most_moves(self.budget),
            "duplicate_deg": DUPLICATE_DEG,
            "identical_refusals": IDENTICAL,
            "prompts": self.prompts,
            **history_settings(self.history),
            **shared_settings(self.convention),
        }

    def answer(self, task: Task) -> Prediction:
        """Play an episode until the model answers, or until no call is left.

        Args:
            task: The question to answer.

        Returns:
            The prediction.
        """
        chat, prompts = self.chat, self.prompts
        return self.play(Episode(task, budget=self.budget, convention=self.convention, chat=chat, prompts=prompts))

    def play(self, episode: Episode) -> Prediction:
        """Play an episode to its end.

        Args:
            episode: A new episode that was made with the chat of this method.

        Returns:
            The prediction.
        """
        system, schema = episode.rules("react_turns"), react_turn_schema(episode.frames, episode.answer_schema)
        looks: list[tuple[Observation, Picture]] = []
        while not episode.over:
            last = episode.turns[-IDENTICAL:]
            if len(last) == IDENTICAL and len(set(last)) == 1:
                episode.force_answer()
            user = with_last_pictures([Message("user", _parts(episode, looks))], self.history)
            reply = episode.attempt.ask([Message("system", (system,)), *user], schema)
            # The next turn states the reason of the refusal.
            with contextlib.suppress(RefusedError):
                if (observation := episode.reply(reply)) is not None:
                    looks.append((observation, picture_of(observation)))
        return episode.finished()


def _parts(episode: Episode, looks: Sequence[tuple[Observation, Picture]]) -> tuple[Part, ...]:
    """Return the parts of a turn: the question, every crop with its metadata, and the looks and moves that are left.

    The changing part comes last, so that a server can cache the common beginning of two turns.
    """
    parts: list[Part] = [episode.text]
    for count, (observation, picture) in enumerate(looks, 1):
        parts += [f"Picture {count}: {metadata_line(observation)}", picture]
    frames, left = sorted({f"{observation.frame_index:06d}" for observation, _ in looks}), episode.left
    state = episode.attempt.render(
        "react_state",
        observations=json.dumps([metadata_of(observation) for observation, _ in looks]),
        turns_json=json.dumps(episode.turns),
        mode=episode.question.answer_mode,
        steps="\n".join(f"{n}. {turn}" for n, turn in enumerate(episode.turns, 1)) or "none",
        seen=", ".join(frames) or "none",
        newest=len(looks) or "none",
        used=len(looks),
        made=len(episode.turns),
        left=left.looks,
        then="look on while anything is uncertain" if left.looks else "no looks are left, so this turn must answer",
        turns=left.moves,
        error=f"Your last turn was malformed, and cost a turn: {episode.error}" if episode.error else "",
    )
    return (*parts, state)


def react_turn_schema(frames: Sequence[int], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a turn, which is a look or the answer.

    Args:
        frames: The frames that can be observed, ascending.
        answer: The schema of an object with the answer and the evidence.

    Returns:
        The schema.
    """
    look = {"frame_id": frame_schema(frames), "angle_deg": {"type": "number"}}
    actions = {"observe": look, "answer": answer["properties"]}
    return {
        "anyOf": [
            decode.closed_object({"action": {"type": "string", "enum": [action]}, **parts})
            for action, parts in actions.items()
        ]
    }
