"""Chain of thought: one call that lists facts of evenly spaced panoramas, and one that answers with them."""

from __future__ import annotations

from typing import Any, ClassVar, Final

from jrdb_avr.agent.methods.attempt import Attempt, FixedContextMethod, panorama_parts
from jrdb_avr.agent.methods.monolithic import answer_from
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Prediction, Task

MOST_FACTS: Final = 20
LONGEST_FACT: Final = 300
"""Characters. Together some 1,500 tokens: a legal list is not cut off at the client's limit."""

_FACTS_SCHEMA: Final = decode.closed_object(
    {
        "reasoning": {
            "type": "array",
            "minItems": 1,
            "maxItems": MOST_FACTS,
            "items": {"type": "string", "minLength": 1, "maxLength": LONGEST_FACT},
        }
    }
)


class ChainOfThought(FixedContextMethod):
    """The method `chain-of-thought` with `n` panoramas, the same ones for both calls."""

    name = "chain-of-thought"
    stages: ClassVar = {"calls": 2, "retries": 1, "most_facts": MOST_FACTS, "longest_fact": LONGEST_FACT}

    def answer(self, task: Task) -> Prediction:
        """Two stages of one call, or two where a reply cannot be read; without facts the second goes on alone."""
        attempt = Attempt(task, self.chat, self.convention)
        panoramas = attempt.panoramas(self.n)
        stage = render("chain_of_thought_facts", most=MOST_FACTS, longest=LONGEST_FACT)
        try:
            facts = attempt.ask_stage(panorama_parts(panoramas), stage, _FACTS_SCHEMA, read_facts)
        except DecodeError:
            facts = ()
        lines = [f"Fact {number}: {fact}" for number, fact in enumerate(facts, 1)]
        return answer_from(attempt, panoramas, "chain_of_thought_answer", ("\n".join(lines or ["Facts: none"]),))


def read_facts(reply: dict[str, Any]) -> tuple[str, ...]:
    """The facts of a reply `{"reasoning": [...]}`, each as one line of single blanks. Raises DecodeError.

    From 1 to MOST_FACTS texts that say something, none longer than LONGEST_FACT characters as it came.
    """
    facts = decode.only_keys(reply, ("reasoning",), "the reply")["reasoning"]
    if not isinstance(facts, list) or not 1 <= len(facts) <= MOST_FACTS:
        raise DecodeError(f"reasoning must be a list of 1 to {MOST_FACTS} facts")
    return tuple(_fact(fact, f"reasoning[{place}]") for place, fact in enumerate(facts))


def _fact(value: object, what: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise DecodeError(f"{what} must be a text that says something")
    if len(value) > LONGEST_FACT:
        raise DecodeError(f"{what} is longer than {LONGEST_FACT} characters")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise DecodeError(f"{what} holds half a character, which no request can carry") from None
    # A fact is sent as one line: a line of its own must not be taken for one of the prompt's.
    return " ".join(value.split())
