"""How each backbone writes boxes and thinking, as data that is chosen by the model's name before its first reply.

The contract of the prompts is the same for all: `bbox`, x1 y1 x2 y2, in thousandths of the image. A convention says
under which other keys a backbone writes its boxes out of habit, and in which order and scale the numbers of each key
are to be read. Nothing here is ever chosen by looking at a true box: a convention is declared, or found by
`calibrate` on drawn rectangles that belong to no question.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

Order = Literal["xyxy", "yxyx"]
Scale = Literal["thousandths", "unit", "pixels", "resized"]
"""The numbers of full width and height: 1000, 1, the image's sides, or its sides after the model's own resizing."""

SCALE: Final = 1000
TOLERANCE: Final = 0.02
"""Coordinates this far outside, as a share of a side, are clipped; farther ones are invalid."""

CONTRACT_KEY: Final = "bbox"


@dataclass(frozen=True)
class Reading:
    """How four numbers become a box."""

    order: Order = "xyxy"
    scale: Scale = "thousandths"


@dataclass(frozen=True)
class Convention:
    """The declared convention of a backbone.

    `boxes`: the accepted keys with the order of their numbers; `bbox` is the contract's, the others are aliases.
    `scales`: of the keys whose numbers are no thousandths. `thinking`: (opening, closing) delimiters. `thinks`: whether
    the chat template thinks by itself (None: not known). `switches`: whether `enable_thinking` in the request's
    `chat_template_kwargs` turns thinking off and on. `multiple` and `image_pixels`: what the model's own
    resizing makes of an image: sides as multiples, pixels at most (0: no such bound known). `calibrated` marks readings
    that were found by `calibrate`, not declared.
    """

    name: str
    boxes: Mapping[str, Order]
    thinking: tuple[tuple[str, str], ...] = (("<think>", "</think>"), ("<|channel>thought", "<channel|>"))
    thinks: bool | None = None
    switches: bool = False
    scales: Mapping[str, Scale] = field(default_factory=dict)
    multiple: int = 1
    image_pixels: int = 0
    calibrated: bool = False

    def reading(self, key: str) -> Reading:
        """How to read a box written under a key; a key that is not declared is the contract's by another name."""
        known = key if key in self.boxes else CONTRACT_KEY
        return Reading(self.boxes[known], self.scales.get(known, "thousandths"))

    def resized(self, width: int, height: int) -> tuple[float, float]:
        """Sides in pixels of an image of `width` x `height` after the model's own resizing."""
        shrink = min(1.0, (self.image_pixels / (width * height)) ** 0.5) if self.image_pixels else 1.0
        across, down = (max(round(side * shrink / self.multiple), 1) * float(self.multiple) for side in (width, height))
        return across, down

    def settings(self) -> dict[str, Any]:
        """The convention in a run's manifest."""
        return {
            "name": self.name,
            "calibrated": self.calibrated,
            "boxes": dict(self.boxes),
            "scales": {key: self.reading(key).scale for key in self.boxes},
            "tolerance": TOLERANCE,
            "thinking": [list(pair) for pair in self.thinking],
            "resizing": {"multiple": self.multiple, "image_pixels": self.image_pixels},
        }


CONTRACT: Final = Convention("contract", {CONTRACT_KEY: "xyxy"})
"""The convention of a model without a declared one."""

# The default budget is 280 soft tokens of 48 x 48 pixels: a whole panorama shrinks to some 60 % a side.
_GEMMA_4: Final = Convention(
    "gemma-4",
    {CONTRACT_KEY: "xyxy", "box_2d": "yxyx"},
    (("<|channel>thought", "<channel|>"),),
    thinks=False,
    switches=True,
    multiple=48,
    image_pixels=280 * 48 * 48,
)
_QWEN3_VL: Final = Convention(
    "qwen3-vl", {CONTRACT_KEY: "xyxy", "bbox_2d": "xyxy"}, (("<think>", "</think>"),), thinks=False, multiple=32
)
_QWEN3_5: Final = replace(_QWEN3_VL, name="qwen3.5", thinks=True, switches=True)
# A model of its own, whose template always begins to think.
_QWEN3_VL_THINKING: Final = replace(_QWEN3_VL, name="qwen3-vl-thinking", thinks=True)

_FAMILIES: Final = (
    (re.compile(r"gemma-?4(?![0-9.]|b)"), _GEMMA_4),
    (re.compile(r"qwen-?3-?vl.*thinking"), _QWEN3_VL_THINKING),
    (re.compile(r"qwen-?3-?vl"), _QWEN3_VL),
    (re.compile(r"qwen-?3[.-]5(?![0-9])"), _QWEN3_5),
)


def convention_of(model: str) -> Convention:
    """The convention of a backbone whose name the model id holds, however it is spelled; CONTRACT for any other."""
    plain = re.sub(r"[\s_:/]+", "-", model.lower())
    return next((convention for pattern, convention in _FAMILIES if pattern.search(plain)), CONTRACT)
