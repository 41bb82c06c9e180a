"""The marker's turns as the reference agent: which of the variants a request belongs to."""

from __future__ import annotations

from typing import Final

from .chatting import chat
from .reading import Request
from .remembering import remember
from .turn import Turn

CALLS: Final = "Your next calls, as one JSON object:"


def agency(request: Request) -> Turn:
    """A turn with the graph, or with the chat in its place."""
    return chat(request) if request.line("Plan: ") is None else remember(request)
