"""Calls of the tools `observe` and `submit_answer` as moves of an episode, for all doors whose player calls tools."""

from __future__ import annotations

from typing import Any

from jrdb_avr.agent.methods.episode import Episode
from jrdb_avr.agent.model.messages import metadata_line
from jrdb_avr.schema.method import Observation


def observe(episode: Episode, **arguments: Any) -> tuple[str, Observation]:
    """Make a look.

    Args:
        episode: The episode.
        **arguments: `frame_id` and `angle_deg` as the player gave them. None stands for a missing argument.

    Returns:
        The text of the result, which has two lines (frame and angle; looks and turns left), and the crop.

    Raises:
        RefusedError: If the look is refused or malformed.
    """
    given = {name: value for name, value in arguments.items() if value is not None}
    observation = episode.move({"action": "observe", **given})
    assert observation is not None, "a look that is not refused returns what it shows"
    left = episode.left
    return f"{metadata_line(observation)}\nLooks left: {left.looks}, turns left: {left.moves}", observation


def submit_answer(episode: Episode, answer: Any, evidence_bboxes: Any) -> str:
    """Submit the final answer.

    Args:
        episode: The episode.
        answer: The answer as the player gave it.
        evidence_bboxes: The evidence as the player gave it.

    Returns:
        The word "taken".

    Raises:
        RefusedError: If the answer is refused or malformed.
    """
    episode.move({"action": "answer", "answer": answer, "evidence_bboxes": evidence_bboxes})
    return "taken"
