"""What a play hands back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from .reading import Request


@dataclass(frozen=True)
class Turn:
    """The reply's object; `missing` says what was missing where it ends the question, and is None where it does not."""

    reply: Mapping[str, Any]
    missing: list[str] | None = None


Play = Callable[[Request], Turn]
"""Plays one stage: a pure function of the request. Raises DecodeError for a request that lacks a line."""
