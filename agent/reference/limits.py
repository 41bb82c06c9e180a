"""Every budget of the reference agent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.agent.methods.attempt import DUPLICATE_DEG, PANORAMAS, fixed_settings
from jrdb_avr.agent.reference.tool_calls import MOST_PER_TURN


@dataclass(frozen=True)
class Limits:
    """looks: observations made; calls: tool calls carried out or refused, looks included, the plan left out; repairs:
    tries after a refused plan; malformed: turns that are no list of calls, the last of which ends the question;
    panoramas: those of a fixed context.
    """

    looks: int = 24
    calls: int = 80
    repairs: int = 3
    malformed: int = 2
    panoramas: int = PANORAMAS

    def model_calls(self, plans: bool) -> int:
        """Model calls at most: a good turn has a call at least, and the last malformed one ends the question."""
        return (1 + self.repairs if plans else 0) + self.calls + self.malformed - 1

    def settings(self, looks: bool, plans: bool) -> dict[str, Any]:
        """What a run's manifest says of a variant's budgets."""
        told = {
            "calls": self.calls,
            "calls_per_turn": MOST_PER_TURN,
            "malformed": self.malformed,
            "model_calls": self.model_calls(plans),
        }
        told |= {"repairs": self.repairs} if plans else {}
        seen = {"looks": self.looks, "duplicate_deg": DUPLICATE_DEG} if looks else fixed_settings(self.panoramas)
        return told | seen


LIMITS: Final = Limits()
"""Those of the benchmark."""
