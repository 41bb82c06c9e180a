"""Function calling: requests with tools are read like turns of ReAct, and replies are calls of the declared tools.

Another program declares `observe` (frame_id, angle_deg) and `answer`, `final_answer` or `submit_answer` (answer,
evidence_bboxes), and sends the lines of a question's heading: `Question:`, `Choices:` and `Legal frames:`. The result
of a call of `observe` holds the picture, in its own message or in a user message after it. The arguments of the call
are its frame and angle. Without a line `Looks made: 3, left: 21`, the budget is 24 looks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.agent.simulated.requests import MessagePart, UserMessage
from jrdb_avr.schema.errors import DecodeError

_OBSERVE: Final = "observe"
_ANSWERS: Final = ("answer", "final_answer", "submit_answer")
_BUDGET: Final = 24
_NEXT_TURN: Final = "Your next turn, as one JSON object:"
_ANSWER_NOW: Final = "Your answer, as one JSON object:"


class _Called(msgspec.Struct):
    name: str
    arguments: str = "{}"


class ToolCall(msgspec.Struct):
    """Call that an earlier reply made."""

    function: _Called
    id: str = ""


class ChatMessage(msgspec.Struct):
    """Message of a request."""

    role: str = "user"
    content: str | UserMessage | None = ""
    tool_calls: list[ToolCall] | None = None
    tool_call_id: str | None = None

    @property
    def parts(self) -> UserMessage:
        """Texts and pictures of the message."""
        return self.content if isinstance(self.content, list) else [MessagePart(self.content or "")]


class _Function(msgspec.Struct):
    name: str


class Tool(msgspec.Struct):
    """Declared tool."""

    function: _Function


def user_turns(messages: Sequence[ChatMessage]) -> list[UserMessage]:
    """Return the user messages and the results of calls. Before each result's picture, a line names frame and angle."""
    turns = []
    due: dict[str, str] = {}
    for message in messages:
        calls = message.tool_calls or ()
        due |= {call.id: f"Picture: {call.function.arguments}" for call in calls if call.function.name == _OBSERVE}
        parts: UserMessage = []
        for part in message.parts:
            if part.image_url is not None and due:
                called = message.tool_call_id if message.tool_call_id in due else None
                parts.append(MessagePart(due.pop(called or next(iter(due)))))
            parts.append(part)
        if message.role not in ("system", "developer", "assistant"):
            turns.append(parts)
    return turns


def with_stage(turns: Sequence[UserMessage], tools: Sequence[Tool]) -> list[UserMessage]:
    """Return the turns. If tools are declared, append the line of the stage that the tools mean."""
    names = {tool.function.name for tool in tools}
    if not turns or not names & {_OBSERVE, *_ANSWERS}:
        return list(turns)
    looks = sum(part.image_url is not None for turn in turns for part in turn)
    stage = _NEXT_TURN if _OBSERVE in names else _ANSWER_NOW
    text = f"Looks made: {looks}, left: {max(_BUDGET - looks, 0)}\n{stage}"
    return [*turns[:-1], [*turns[-1], MessagePart(text)]]


def tool_calls(reply: Mapping[str, Any], tools: Sequence[Tool], turn: int) -> list[dict[str, Any]]:
    """Return a reply of ReAct as a call of a declared tool, with an id of this turn.

    Raises:
        DecodeError: If the tool is not declared.
    """
    wanted = (_OBSERVE,) if reply.get("action") == _OBSERVE else _ANSWERS
    name = next((tool.function.name for tool in tools if tool.function.name in wanted), None)
    if name is None:
        raise DecodeError(f"the simulated model calls {' or '.join(wanted)}, which the request does not declare")
    sent = msgspec.json.encode({key: value for key, value in reply.items() if key != "action"}).decode()
    return [{"id": f"call_{turn}", "type": "function", "function": {"name": name, "arguments": sent}}]
