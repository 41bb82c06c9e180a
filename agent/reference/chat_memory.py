"""Memory in a chat history. All messages stay in it, and the final answer has its own box."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

from jrdb_avr.agent.look.attention import NextLook
from jrdb_avr.agent.methods.attempt import Attempt, ParsedReply
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.decode import BOX_SCHEMA, box_key, read_box
from jrdb_avr.agent.model.messages import Message, with_last_pictures
from jrdb_avr.agent.model.reply import Reply, answer_text
from jrdb_avr.agent.reference.turns import (
    FINAL,
    Call,
    NamedView,
    Turn,
    call_schema,
    find_view,
    look_schema,
    turn_schema,
    view_parts,
)
from jrdb_avr.schema.answers import Evidence
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama

LONGEST_REPLY: Final = 8000
"""Maximum number of characters of a reply that stay in the history."""

LONGEST_UNREAD: Final = 400
"""Maximum number of characters of an unreadable reply that stay in the history."""

OBSERVATION_SCHEMA: Final = {"type": "string", "pattern": "^o[0-9]+$"}


@dataclass
class ChatMemory:
    """Memory of an agent without a world model: the chat of one question.

    most_pictures: number of newest pictures that are sent, None for all. parsed: the newest answer and the newest box
    that could be read. unread: whether the last reply or final answer could not be read.
    """

    advises: ClassVar = False
    tools: ClassVar = (FINAL,)
    """The only tool: the final answer."""

    attempt: Attempt
    system: str
    heading: str
    most_pictures: int | None = None
    history: list[Message] = field(default_factory=list)
    parsed: ParsedReply = field(default_factory=ParsedReply)
    unread: bool = False
    _names: int = 0

    def messages(self, turn: Turn) -> list[Message]:
        """Return all messages so far, and the message of this turn.

        Args:
            turn: The turn.

        Returns:
            The chat, without pictures that are older than the last `most_pictures`.
        """
        first = not self.history
        if first:
            self.history.append(Message("system", (self.system,)))
        opening = self.heading if first else turn.result_lines()
        self.history.append(Message("user", (opening, *view_parts(turn.views), turn.state())))
        return with_last_pictures(self.history, self.most_pictures)

    def replied(self, reply: Reply, readable: bool) -> None:
        """Append a reply to the history, shortened.

        Args:
            reply: The reply.
            readable: Whether the reply is a list of calls.
        """
        longest = LONGEST_REPLY if readable else LONGEST_UNREAD
        text = answer_text(reply, self.attempt.convention)[:longest].encode("utf-8", "backslashreplace").decode()
        # Some servers refuse a message without text.
        self.history.append(Message("assistant", (text or "(nothing)",)))
        self.unread = not readable

    def schema(self, looks: bool) -> dict[str, Any]:
        """Return the JSON Schema of a turn.

        Args:
            looks: Whether looks can be made.

        Returns:
            The schema.
        """
        answer, frames = self.attempt.answer_schema(), self.attempt.task.sequence.frames
        final = call_schema(FINAL, {"answer": answer, "observation": OBSERVATION_SCHEMA, "box": BOX_SCHEMA})
        return turn_schema([*([look_schema(frames, advised=False)] if looks else []), final])

    def name_view(self, observation: Observation | Panorama, step: int) -> str:
        """Return the name of a new observation: "o1", "o2", ..."""
        self._names += 1
        return f"o{self._names}"

    def refuse(self, call: Call, reason: str, step: int) -> None:
        """Do nothing, because the next message states the refusal."""

    def carry_out(self, call: Call, views: Mapping[str, NamedView], step: int) -> str:
        """Refuse the call, because a chat has only `final_answer`.

        Raises:
            DecodeError: Always.
        """
        raise DecodeError(f"there is no tool {call.tool}")

    def due_looks(self, left: int) -> Sequence[NextLook]:
        """Return no look, because a chat does not advise."""
        return ()

    def finish(self, call: Call, views: Mapping[str, NamedView], left: int, step: int) -> ParsedReply:
        """Read a final answer. Its answer and its box are read independently, and the readable part is kept.

        Args:
            call: The call with `answer`, `observation` and `box`.
            views: All observations by name.
            left: Number of looks that are left.
            step: Index of the model call.

        Returns:
            The answer and the box.

        Raises:
            DecodeError: If the answer or the box cannot be read.
        """
        self.unread = True
        key = box_key(call.arguments, self.attempt.convention, "box")
        part = decode.only_keys(call.arguments, ("answer", "observation", key), "the call")
        started = time.perf_counter()
        (answer, evidence), faults = decode.read_each(
            lambda: self.attempt.read_answer(part["answer"]),
            lambda: self._evidence(part["observation"], part[key], key, views),
        )
        self.parsed = ParsedReply(answer, evidence).over(self.parsed)
        parsed = {"answer": answer, "evidence": evidence, "box_key": key, "faults": faults}
        self.attempt.record("solve", {"observation": call.text}, parsed, started)
        if faults:
            raise DecodeError("; ".join(faults))
        self.unread = False
        return self.parsed

    def _evidence(self, observation: object, box: object, key: str, views: Mapping[str, NamedView]) -> Evidence:
        """Return the box in stitched pixels, x in [0, 3760)."""
        image = find_view(observation, views).image
        return image.evidence(image.frames[0], read_box(box, image.size, self.attempt.convention, key))

    def commit(self, reason: str, step: int) -> ParsedReply:
        """Return the newest readable answer and box.

        Args:
            reason: Why no final answer was accepted.
            step: Index of the last step.

        Returns:
            The parts that could be read.
        """
        return replace(self.parsed, faults=(reason,) if self.unread else (), refusal=reason)
