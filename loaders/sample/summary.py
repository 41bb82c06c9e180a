"""The sample's shares beside those of JRDB."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .writer import Written


def rows(written: Sequence[Written]) -> list[dict[str, Any]]:
    """One row per share: what, here, in JRDB (the test split; hard labels also its train split, interactions that
    alone)."""

    def share(part: int, whole: int) -> str:
        return f"{100 * part / whole:.1f} %" if whole else "n/a"

    def total(field: str) -> int:
        return sum(getattr(one, field) for one in written)

    frames = total("frames")
    return [
        {
            "what": "boxes severely or fully occluded",
            "here": share(total("occluded"), total("boxes")),
            "JRDB": "56 %",
        },
        {
            "what": "action labels of difficulty 3",
            "here": share(total("hard_labels"), total("labels")),
            "JRDB": "26-42 %",
        },
        {
            "what": "people with a gap at keyframes",
            "here": share(total("tracks_with_gaps"), total("tracks")),
            "JRDB": "30 %",
        },
        {
            "what": "people per frame",
            "here": f"{total('boxes') / frames:.1f}" if frames else "n/a",
            "JRDB": "34",
        },
        {
            "what": "3D boxes without lidar points",
            "here": share(total("without_points"), total("solid")),
            "JRDB": "3 %",
        },
        {
            "what": "interactions per person and frame",
            "here": f"{total('interactions') / total('boxes'):.2f}" if total("boxes") else "n/a",
            "JRDB": "1.7",
        },
    ]
