"""Chain of thought: one model call lists facts about panoramas, and a second call answers with these facts."""

from __future__ import annotations

from typing import Any, ClassVar, Final

from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.methods.monolithic import answer_from
from jrdb_avr.agent.methods.requests import FixedContextMethod, frame_list, panorama_parts
from jrdb_avr.agent.model import decode
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Prediction, Task

MOST_FACTS: Final = 20
LONGEST_FACT: Final = 300
"""Maximum characters of a fact. The longest possible list has some 1,500 tokens, below the default limit of a reply."""

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
    """The method `chain-of-thought` with `n` panoramas. Both calls get the same panoramas."""

    name = "chain-of-thought"
    stages: ClassVar = {"calls": 2, "retries": 1, "most_facts": MOST_FACTS, "longest_fact": LONGEST_FACT}

    def answer(self, task: Task) -> Prediction:
        """Answer in two stages: list facts, then answer with these facts, or without facts if the list cannot be read.

        Args:
            task: The question to answer.

        Returns:
            The prediction.
        """
        attempt = Attempt(task, self.chat, self.convention, self.prompts)
        panoramas = attempt.panoramas(self.n)
        stage = attempt.render(
            "chain_of_thought_facts", most=MOST_FACTS, longest=LONGEST_FACT, frames=frame_list(panoramas)
        )
        try:
            facts = attempt.ask_stage(panorama_parts(panoramas), stage, _FACTS_SCHEMA, read_facts)
        except DecodeError:
            facts = ()
        lines = [f"Fact {position}: {fact}" for position, fact in enumerate(facts, 1)] or ["Facts: none"]
        listed = attempt.render("chain_of_thought_list", lines="\n".join(lines), joined=" | ".join(facts) or "none")
        return answer_from(attempt, panoramas, "chain_of_thought_answer", (listed,))


def read_facts(reply: dict[str, Any]) -> tuple[str, ...]:
    """Decode the facts of a reply.

    Args:
        reply: The object `{"reasoning": [...]}`.

    Returns:
        The facts. Each fact is one line with single blanks between its words.

    Raises:
        DecodeError: If there are no facts or too many facts, or if a fact is empty or too long.
    """
    facts = decode.only_keys(reply, ("reasoning",), "the reply")["reasoning"]
    if not isinstance(facts, list) or not 1 <= len(facts) <= MOST_FACTS:
        raise DecodeError(f"reasoning must be a list of 1 to {MOST_FACTS} facts")
    return tuple(_fact(fact, f"reasoning[{index}]") for index, fact in enumerate(facts))


def _fact(value: object, what: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise DecodeError(f"{what} must be a text that says something")
    if len(value) > LONGEST_FACT:
        raise DecodeError(f"{what} is longer than {LONGEST_FACT} characters")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise DecodeError(f"{what} holds half a character, which no request can carry") from None
    # A fact is sent as one line, because a second line could look like a line of the prompt.
    return " ".join(value.split())
