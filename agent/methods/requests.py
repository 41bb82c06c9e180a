"""Parts that the requests and the manifests of several methods share: heading of a task, panoramas, and settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.messages import Part, metadata_line, picture_of
from jrdb_avr.agent.model.prompts import PromptSet, choice_lines, render
from jrdb_avr.schema.method import Panorama, Question
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH

PANORAMAS: Final = 8
"""Number of panoramas for a method that cannot choose its looks."""


def uniform_frames(frames: Sequence[int], n: int = PANORAMAS) -> tuple[int, ...]:
    """Select frames that are evenly spaced in the list of legal frames.

    Args:
        frames: The m legal frames, ascending.
        n: The number of frames to select, from 1.

    Returns:
        For each i from 0 to n - 1, the frame at position i * (m - 1) / (n - 1). A position is rounded to the nearest
        integer, and a position halfway between two integers is rounded up. If n is 1: the middle frame, or the earlier
        of two middle frames. If m is at most n: all frames.

    Raises:
        ValueError: If n is below 1.

    >>> uniform_frames(range(0, 100, 5), 4)
    (0, 30, 65, 95)
    """
    if n < 1:
        raise ValueError("a fixed context holds one panorama at least")
    if len(frames) <= n:
        return tuple(frames)
    last = len(frames) - 1
    if n == 1:
        return (frames[last // 2],)
    # The distance between positions is more than 1, so that rounding never selects a frame twice.
    return tuple(frames[(2 * i * last + n - 1) // (2 * (n - 1))] for i in range(n))


def panorama_parts(panoramas: Sequence[Panorama]) -> tuple[Part, ...]:
    """Return panoramas as parts of a message.

    Args:
        panoramas: The panoramas.

    Returns:
        The pictures. Before each picture is a line with its number and its metadata.
    """
    return tuple(
        part
        for count, panorama in enumerate(panoramas, 1)
        for part in (f"Panorama {count}: {metadata_line(panorama)}", picture_of(panorama))
    )


def frame_list(panoramas: Sequence[Panorama]) -> str:
    """List the frame ids of panoramas.

    Args:
        panoramas: The panoramas.

    Returns:
        The ids, separated by commas.
    """
    return ", ".join(f"{panorama.frame_index:06d}" for panorama in panoramas)


def fixed_settings(n: int) -> dict[str, Any]:
    """Return the settings that a run's manifest records for a method that gets panoramas.

    Args:
        n: The number of panoramas.

    Returns:
        The settings.
    """
    return {"panoramas": n, "frames": "evenly spaced by position among the legal ones, first and last included"}


def heading(question: Question) -> str:
    """Return the lines with which the request of every method begins.

    Args:
        question: The question.

    Returns:
        The text of the question, its answer mode, and its choices, numbered from 1.
    """
    choices = choice_lines(question.choices)
    return render(
        "heading",
        question=question.question,
        mode=question.answer_mode,
        choices=f"Choices:\n{choices}" if choices else "No choices.",
    )


def shared_settings(convention: Convention) -> dict[str, Any]:
    """Return the settings that every method has in a run's manifest.

    Args:
        convention: The convention of the model.

    Returns:
        The settings.
    """
    sizes = {"panorama": [WIDTH, HEIGHT], "crop": [CROP, CROP]}
    return {"convention": convention.settings(), "image_sizes": sizes}


def history_settings(history: int | None) -> dict[str, Any]:
    """Return the setting that limits the pictures of a request, as a run's manifest records it.

    Args:
        history: The number of newest pictures that are sent. None sends all.

    Returns:
        The setting by name. The dictionary is empty if all pictures are sent.
    """
    return {} if history is None else {"history": history}


@dataclass(frozen=True)
class FixedContextMethod:
    """Base class of methods that answer from the panoramas of `n` evenly spaced frames.

    stages: further settings of the method by name, such as the number of its model calls.
    """

    name: ClassVar[str]
    stages: ClassVar[Mapping[str, int]]

    chat: Chat
    convention: Convention = CONTRACT
    n: int = PANORAMAS
    prompts: PromptSet = "default"

    def settings(self) -> dict[str, Any]:
        """Return the method's settings for a run's manifest."""
        fixed = {**fixed_settings(self.n), **self.stages, "prompts": self.prompts}
        return {**fixed, **shared_settings(self.convention)}
