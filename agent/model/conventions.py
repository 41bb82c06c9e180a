"""Conventions: how each family of models writes boxes and thinking. A model's name selects its convention.

The prompts request the same form from all models: the key `bbox` with x1, y1, x2, y2 in thousandths of the image. This
form is called the contract. Some models write boxes under other keys out of habit. A convention lists these keys, with
the order and the scale of the numbers under each key. A convention is declared here, or `calibrate` finds it with drawn
rectangles. It never depends on the true boxes of questions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

Order = Literal["xyxy", "yxyx"]
Scale = Literal["thousandths", "pixels", "unit", "resized"]
"""The unit of the numbers of a box, in order of simplicity.

The full width of an image is 1000 ("thousandths"), its width in pixels ("pixels"), 1 ("unit"), or its width in pixels
after the model has resized it ("resized").
"""

SCALE: Final = 1000
TOLERANCE: Final = 0.02
"""Maximum distance from the image, as a share of its side, of a coordinate that is clipped to the image."""

CONTRACT_KEY: Final = "bbox"


_TAGS: Final = tuple((f"<{tag}>", f"</{tag}>") for tag in ("think", "thinking", "thought", "reasoning", "seed:think"))
_MARKS: Final = (("◁think▷", "◁/think▷"), ("[THINK]", "[/THINK]"), ("<|START_THINKING|>", "<|END_THINKING|>"))
_CHANNELS: Final = (("<|channel>thought", "<channel|>"), ("<|channel|>analysis<|message|>", "<|end|>"))
"""Delimiters of thinking: of Qwen and others, of Kimi, Magistral and Command, and of Gemma and gpt-oss."""

_HEADS: Final = ("<|start|>assistant", "<|channel|>final", "<|constrain|>json", "<|message|>", "<|START_RESPONSE|>")
_BOXES: Final = ("<|begin_of_box|>", "<|end_of_box|>", "<answer>", "</answer>", "<|END_RESPONSE|>")
_ENDS: Final = ("<|return|>", "<|end|>", "<|im_end|>", "<|eot_id|>", "<|endoftext|>", "<end_of_turn>", "</s>")
"""Delimiters around the answer: of channels, boxes, and the ends of turns."""


@dataclass(frozen=True)
class Reading:
    """The order and the scale of the four numbers of a box."""

    order: Order = "xyxy"
    scale: Scale = "thousandths"


@dataclass(frozen=True)
class Convention:
    """Convention of a family of models.

    boxes: the keys under which a reply may hold a box, each with the order of its four numbers. The contract's key
    `bbox` is always one of these keys. scales: the scale of the numbers under a key of `boxes`. If a key is missing in
    `scales`, its numbers are in thousandths of the image. thinking: pairs of delimiters that open and close the
    thinking in a reply. around: delimiters that may begin or end the rest, removed once each, in order. thinks: whether
    the chat template makes the model think by default, None if unknown. switches: whether `enable_thinking` in
    `chat_template_kwargs` turns thinking on and off. multiple: the model resizes images so that both sides are
    multiples of this number of pixels. A square of this side becomes a token. least_pixels and image_pixels: the
    minimum and maximum number of pixels of a resized image, 0 if unknown. fills: whether the model enlarges all images
    to the maximum. calibrated: whether `calibrate` found the orders and scales.
    """

    name: str
    boxes: Mapping[str, Order]
    thinking: tuple[tuple[str, str], ...] = (*_TAGS, *_MARKS, *_CHANNELS)
    around: tuple[str, ...] = (*_HEADS, *_BOXES, *_ENDS)
    thinks: bool | None = None
    switches: bool = False
    scales: Mapping[str, Scale] = field(default_factory=dict)
    multiple: int = 1
    least_pixels: int = 0
    image_pixels: int = 0
    fills: bool = False
    calibrated: bool = False

    def reading(self, key: str) -> Reading:
        """Return how to read the numbers under a key.

        Args:
            key: The key of the box. A key that is not declared is read like the contract's key.

        Returns:
            The order and the scale of the numbers.
        """
        listed_key = key if key in self.boxes else CONTRACT_KEY
        return Reading(self.boxes[listed_key], self.scales.get(listed_key, "thousandths"))

    def resized(self, width: int, height: int) -> tuple[float, float]:
        """Return the sides of an image after the model's own resizing.

        Args:
            width: The image's width in pixels.
            height: The image's height in pixels.

        Returns:
            Width and height in pixels.
        """
        rounding: Callable[[float], int] = round
        scale, pixels = 1.0, self._multiples(width) * self._multiples(height)
        if self.fills or pixels > self.image_pixels > 0:
            rounding, scale = math.floor, math.sqrt(self.image_pixels / max(width * height, 1))
        elif pixels < self.least_pixels:
            rounding, scale = math.ceil, math.sqrt(self.least_pixels / max(width * height, 1))
        return self._multiples(width * scale, rounding), self._multiples(height * scale, rounding)

    def picture_tokens(self, width: int, height: int) -> int | None:
        """Return the number of tokens of a picture, without the tokens that delimit it.

        Args:
            width: The picture's width in pixels.
            height: The picture's height in pixels.

        Returns:
            The number of tokens, None if the resizing of the family is not declared.
        """
        across, down = self.resized(width, height)
        return round(across * down / self.multiple**2) if self.multiple > 1 else None

    def _multiples(self, side: float, rounding: Callable[[float], int] = round) -> float:
        return float(max(rounding(side / self.multiple), 1) * self.multiple)

    def settings(self) -> dict[str, Any]:
        """Return the convention as a run's manifest records it."""
        return {
            "name": self.name,
            "calibrated": self.calibrated,
            "boxes": dict(self.boxes),
            "scales": {key: self.reading(key).scale for key in self.boxes},
            "tolerance": TOLERANCE,
            "thinking": [list(pair) for pair in self.thinking],
            "resizing": {key: getattr(self, key) for key in ("multiple", "least_pixels", "image_pixels", "fills")},
        }


CONTRACT: Final = Convention("contract", {CONTRACT_KEY: "xyxy"})
"""Convention of models from families without a declared convention."""

# By default, an image becomes at most 280 tokens of 48 x 48 pixels. docs/servers.md names the sources of the resizing.
_GEMMA_4: Final = Convention(
    "gemma-4",
    {CONTRACT_KEY: "xyxy", "box_2d": "yxyx"},
    (("<|channel>thought", "<channel|>"),),
    thinks=False,
    switches=True,
    multiple=48,
    image_pixels=280 * 48 * 48,
    fills=True,
)
_QWEN3_VL: Final = Convention(
    "qwen3-vl",
    {CONTRACT_KEY: "xyxy", "bbox_2d": "xyxy"},
    (("<think>", "</think>"),),
    thinks=False,
    multiple=32,
    least_pixels=64 * 32 * 32,
    image_pixels=16_384 * 32 * 32,
)
_QWEN3_5: Final = replace(_QWEN3_VL, name="qwen3.5", thinks=True, switches=True)
# This model differs from Qwen3-VL: its chat template always starts the reply with thinking.
_QWEN3_VL_THINKING: Final = replace(_QWEN3_VL, name="qwen3-vl-thinking", thinks=True)

_FAMILIES: Final = (
    (re.compile(r"gemma-?4(?![0-9.]|b)"), _GEMMA_4),
    (re.compile(r"qwen-?3-?vl.*thinking"), _QWEN3_VL_THINKING),
    (re.compile(r"qwen-?3-?vl"), _QWEN3_VL),
    (re.compile(r"qwen-?3[.-]5(?![0-9])"), _QWEN3_5),
)


def convention_of(model: str) -> Convention:
    """Return the convention of a model's family.

    Args:
        model: The model id, in any spelling.

    Returns:
        The family's convention, or CONTRACT if the family is unknown.
    """
    plain = re.sub(r"[\s_:/]+", "-", model.lower())
    return next((convention for pattern, convention in _FAMILIES if pattern.search(plain)), CONTRACT)
