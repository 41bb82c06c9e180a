"""The stages that the marker plays, by the last line of a request."""

from __future__ import annotations

from typing import Final

from .agency import CALLS, agency
from .looking import REACT, react
from .planning import PLAN, plan
from .turn import Play

STAGES: Final[dict[str, Play]] = {
    REACT: react,
    PLAN: plan,
    CALLS: agency,
}
