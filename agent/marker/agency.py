"""The marker's turns as the reference agent: which of the variants a request belongs to."""

from __future__ import annotations

from typing import Final

from .chatting import chat
from .passive import remember_shown
from .reading import Request
from .remembering import remember
from .turn import Turn

CALLS: Final = "Your next calls, as one JSON object:"


def agency(request: Request) -> Turn:
    """A turn with the graph, or with the chat in its place; with looks, or with panoramas in theirs."""
    if request.line("Plan: ") is None:
        return chat(request)
    return remember_shown(request) if any(look.panorama for look in request.looks) else remember(request)
