"""Memory in a chat history: all messages stay in it, or their words alone; the final answer carries its own box."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

from jrdb_avr.agent.methods.attempt import Attempt, ParsedReply
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.decode import BOX_SCHEMA, box_key, read_box
from jrdb_avr.agent.model.messages import Message, with_last_pictures
from jrdb_avr.agent.model.reply import Reply, answer_text
from jrdb_avr.agent.reference.graph_memory import OBSERVATION_SCHEMA
from jrdb_avr.agent.reference.tool_calls import FINAL, Call, Turn, View, call_schema, turn_schema, view_parts
from jrdb_avr.schema.answers import Evidence
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama

LONGEST_REPLY: Final = 8000
"""Characters of a reply that stay in the history."""

LONGEST_UNREAD: Final = 400
"""The same of one that could not be read: eighty of them are to fit into a model's context."""


@dataclass
class ChatMemory:
    """The memory of an agent without a world model: the chat of one question.

    most_pictures: how many of the newest pictures are sent, None for all; proposed: the newest answer and the newest
    box that could be read.
    """

    tools: ClassVar = (FINAL,)
    attempt: Attempt
    system: str
    heading: str
    most_pictures: int | None = None
    history: list[Message] = field(default_factory=list)
    names: int = 0
    proposed: ParsedReply = field(default_factory=ParsedReply)

    # -- what the model is sent ---------------------------------------------------------------------------------------

    def messages(self, turn: Turn) -> list[Message]:
        """All messages so far, and this turn's results, pictures and what is left."""
        first = not self.history
        if first:
            self.history.append(Message("system", (self.system,)))
        opening = self.heading if first else turn.result_lines()
        self.history.append(Message("user", (opening, *view_parts(turn.fresh), turn.state())))
        return with_last_pictures(self.history, self.most_pictures)

    def replied(self, reply: Reply) -> None:
        text = answer_text(reply, self.attempt.convention)[:LONGEST_REPLY].encode("utf-8", "backslashreplace").decode()
        # Some servers refuse a message without words.
        self.history.append(Message("assistant", (text or "(nothing)",)))

    def unread(self) -> None:
        """Cut the last reply short, which could not be read."""
        (text,) = self.history.pop().parts
        assert isinstance(text, str), "a reply is text"
        self.history.append(Message("assistant", (text[:LONGEST_UNREAD],)))

    def schema(self, looks: Mapping[str, Any] | None) -> dict[str, Any]:
        """The JSON Schema of a turn; `looks` is that of a look, where there are looks."""
        question = self.attempt.task.question
        answer = decode.answer_schema(question.answer_mode, question.choices)
        final = call_schema(FINAL, {"answer": answer, "observation": OBSERVATION_SCHEMA, "box": BOX_SCHEMA})
        return turn_schema([*([looks] if looks else []), final])

    # -- what is named, and what is read from it ----------------------------------------------------------------------

    def named(self, seen: Observation | Panorama, step: int) -> str:
        self.names += 1
        return f"o{self.names}"

    def refused(self, call: Call, step: int, reason: str) -> None:
        """Does nothing: the chat history shows the refusal."""

    def carry_out(self, call: Call, views: Mapping[str, View], step: int) -> str:
        raise DecodeError(f"there is no tool {call.tool!r}")

    def propose(self, call: Call, views: Mapping[str, View]) -> None:
        """Read answer and box apart, and keep what can be read. Raises DecodeError for what cannot."""
        key = box_key(call.arguments, self.attempt.convention, "box")
        part = decode.only_keys(call.arguments, ("answer", "observation", key), "the call")
        started = time.perf_counter()
        (answer, evidence), faults = decode.read_each(
            lambda: self.attempt.read_answer(part["answer"]),
            lambda: self._evidence(part["observation"], part[key], key, views),
        )
        self.proposed = ParsedReply(answer, evidence).over(self.proposed)
        parsed = {"answer": answer, "evidence": evidence, "box_key": key, "faults": faults}
        self.attempt.record("solve", {"observation": call.text}, parsed, started)
        if faults:
            raise DecodeError("; ".join(faults))

    def judge(self, call: Call, step: int) -> ParsedReply:
        """Returns the answer and box that were just proposed, as they are."""
        return self.proposed

    def _evidence(self, observation: object, box: object, key: str, views: Mapping[str, View]) -> Evidence:
        """The box in stitched pixels, x in [0, 3760)."""
        view = views.get(observation) if isinstance(observation, str) else None
        if view is None:
            raise DecodeError("observation must name one that has been made")
        image = view.image
        return image.evidence(image.frames[0], read_box(box, image.size, self.attempt.convention, key))

    def commit(self) -> ParsedReply:
        """What counts where no final answer was taken."""
        return self.proposed
