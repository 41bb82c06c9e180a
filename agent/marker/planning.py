"""The marker's plans: what the question's words say, as the one template table reads them."""

from __future__ import annotations

from typing import Final

import msgspec

from .reading import Request
from .turn import Turn

PLAN: Final = "Your plan, as one JSON object:"


def plan(request: Request) -> Turn:
    """The question's plan; a plan that was refused is said again, as there is no other reading of the words."""
    return Turn(msgspec.to_builtins(request.plan))
