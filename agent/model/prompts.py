"""Prompt texts. Each prompt is a Markdown file in `prompts/` with slots `$name`, which `render` fills in."""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Sequence
from importlib.resources import files
from string import Template
from typing import Final, Literal, NamedTuple

from jrdb_avr.schema.method import Task

PromptSet = Literal["default", "paper"]
"""Name of a set of the baselines' prompts. The set `paper` follows the prompts of the paper in its own words."""

FOLDERS: Final[dict[PromptSet, str]] = {"default": "", "paper": "paper/"}
"""Beginning of the names of a set's prompts."""


def render(name: str, **slots: object) -> str:
    """Fill in a prompt.

    Args:
        name: The name of the prompt. Its file is `prompts/<name>.md`.
        slots: The values of the prompt's slots. A `$` in a value does not begin a slot.

    Returns:
        The text without a newline at the end.
    """
    return _template(name).substitute({key: str(value) for key, value in slots.items()})


@functools.cache
def _template(name: str) -> Template:
    return Template((files("jrdb_avr.agent") / "prompts" / f"{name}.md").read_text(encoding="utf-8").rstrip("\n"))


class ModeText(NamedTuple):
    """Prompt lines of an answer mode.

    form: an example of an answer. rule: the rule for the form of an answer. advice: advice for finding the answer.
    """

    form: str
    rule: str
    advice: str = ""


def mode_text(task: Task, prompts: PromptSet = "default") -> ModeText:
    """Return the prompt lines of a task's answer mode. They are the three lines of `prompts/answer_<mode>.md`.

    Args:
        task: The question to answer, with its sequence.
        prompts: The set of prompts.

    Returns:
        The lines.
    """
    last_frame = f"{task.sequence.frame_count - 1:06d}"
    name = f"{FOLDERS[prompts]}answer_{task.question.answer_mode}"
    return ModeText(*render(name, last_frame=last_frame).split("\n"))


def choice_lines(choices: Sequence[str]) -> str:
    """Return the choices of a question as numbered lines.

    Args:
        choices: The choices.

    Returns:
        A line per choice, numbered from 1.
    """
    return "\n".join(f"{position}. {choice}" for position, choice in enumerate(choices, 1))


def frame_ranges(frames: Sequence[int]) -> str:
    """Write frames as ranges. `read_frame_ranges` is the inverse function.

    Args:
        frames: Ascending frames.

    Returns:
        The ranges, separated by commas. The frames of a range are evenly spaced.

    >>> frame_ranges([0, 5, 10, 15, 16])
    '000000 to 000015 in steps of 5, 000016'
    """
    parts = []
    start = 0
    while start < len(frames):
        end = min(start + 1, len(frames) - 1)
        step = frames[end] - frames[start]
        while end + 1 < len(frames) and frames[end + 1] - frames[end] == step:
            end += 1
        if end - start == 1:
            # A range of only two frames is not made, because the second frame may begin a longer range.
            end = start
        first, last = f"{frames[start]:06d}", f"{frames[end]:06d}"
        parts.append(first if end == start else f"{first} to {last} in steps of {step}")
        start = end + 1
    return ", ".join(parts) or "none"


_RANGE = re.compile(r"(\d{6})(?: to (\d{6}) in steps of ([1-9]\d{0,6}))?")


def read_frame_ranges(text: str) -> list[int]:
    """Read the frames of a text that `frame_ranges` wrote.

    Args:
        text: The ranges.

    Returns:
        The frames.
    """
    matches = [_RANGE.fullmatch(part) for part in text.split(", ")]
    spans = [
        range(int(m[1]), int(m[2]) + 1, int(m[3])) if m[2] else range(int(m[1]), int(m[1]) + 1) for m in matches if m
    ]
    return list(itertools.chain.from_iterable(spans))
