"""The stages that the marker plays, by the last line of a request."""

from __future__ import annotations

from typing import Final

from .agency import CALLS, agency
from .baselines import ANSWER, BOX, CHOICE, FACTS, PLACE, answer_at_once, choose, propose, refine, write_facts
from .looking import REACT, react
from .planning import PLAN, plan
from .turn import Play

STAGES: Final[dict[str, Play]] = {
    ANSWER: answer_at_once,
    FACTS: write_facts,
    PLACE: propose,
    BOX: refine,
    CHOICE: choose,
    REACT: react,
    PLAN: plan,
    CALLS: agency,
}
