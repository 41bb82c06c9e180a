"""Function calling: requests with tools are read like turns of ReAct, and replies are calls of the declared tools.

Another harness declares `observe` (frame_id, angle_deg) and `answer`, `final_answer` or `submit_answer` (answer,
evidence_bboxes), and sends the lines of a question's heading: `Question:`, `Choices:` and `Legal frames:`. The result
of a call of `observe` holds the picture, in its own message or in a user message after it. The arguments of the call
are its frame and angle. Without a line `Looks made: 3, left: 21`, the budget is 24 looks.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.agent.simulated.requests import FrameId, MessagePart, UserMessage, lines_of
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


class _Parameters(msgspec.Struct):
    properties: dict[str, Any] = {}
    required: list[str] = []


class _Function(msgspec.Struct):
    name: str
    parameters: _Parameters = msgspec.field(default_factory=_Parameters)


class Tool(msgspec.Struct):
    """Declared tool."""

    function: _Function


class _Look(msgspec.Struct):
    frame_id: FrameId
    angle_deg: float


# Made at import, because threads that meet a type first at the same time crash the decoder.
_LOOK: Final = msgspec.json.Decoder(_Look)


def user_turns(messages: Sequence[ChatMessage]) -> list[UserMessage]:
    """Return the user messages and the results of calls. Before each result's picture, a line names frame and angle."""
    turns = []
    due: dict[str, str] = {}
    for message in messages:
        if message.role in ("system", "developer"):
            continue
        if message.role == "assistant":
            due |= {call.id: _placed(call) for call in message.tool_calls or () if call.function.name == _OBSERVE}
            continue
        parts: UserMessage = []
        for part in message.parts:
            if part.image_url is not None and due and not (parts and parts[-1].text.endswith("}")):
                name = message.tool_call_id if message.tool_call_id in due else next(iter(due))
                parts.append(MessagePart(due.pop(name)))
            parts.append(part)
        turns.append(parts)
    return turns


def _placed(call: ToolCall) -> str:
    """Return the line before the picture that a call of `observe` returns."""
    try:
        look = _LOOK.decode(call.function.arguments)
    except msgspec.DecodeError as error:
        raise DecodeError(f"the arguments of an earlier call of {_OBSERVE} cannot be read: {error}") from None
    return f"Picture: {msgspec.json.encode(look).decode()}"


def with_stage(
    turns: Sequence[UserMessage], tools: Sequence[Tool], choice: Any, stages: Collection[str]
) -> list[UserMessage]:
    """Return the turns. If their last line names no stage, append the line of the stage that the tools mean."""
    names = {tool.function.name for tool in tools}
    lines = lines_of(turns[-1]) if turns else ()
    if not turns or (lines and lines[-1] in stages) or not names & {_OBSERVE, *_ANSWERS}:
        return list(turns)
    stage = _NEXT_TURN if _OBSERVE in names else _ANSWER_NOW
    looks = sum(part.image_url is not None for turn in turns for part in turn)
    left = 0 if forced(choice) in _ANSWERS else max(_BUDGET - looks, 0)
    stated = any(line.startswith("Looks made: ") for line in lines)
    text = stage if stated else f"Looks made: {looks}, left: {left}\n{stage}"
    return [*turns[:-1], [*turns[-1], MessagePart(text)]]


def forced(choice: Any) -> str | None:
    """Return the tool that a request's `tool_choice` names, or None. Raise DecodeError for other forms."""
    match choice:
        case None | "auto" | "required" | "none":
            return None
        case {"type": "function", "function": {"name": str(name)}}:
            return name
    raise DecodeError("tool_choice must be auto, required, none, or name one function")


def tool_calls(reply: Mapping[str, Any], tools: Sequence[Tool], choice: Any, turn: int) -> list[dict[str, Any]]:
    """Return a reply as calls of the declared tools.

    Args:
        reply: Reply as an object.
        tools: Declared tools.
        choice: The request's `tool_choice`.
        turn: Number of the turn, for the ids of the calls.

    Returns:
        The calls. The list is empty if the reply calls no tool.

    Raises:
        DecodeError: If a tool or an argument is missing, or if another tool is forced.
    """
    declared = {tool.function.name: tool.function.parameters for tool in tools}
    if "calls" in reply:
        wanted = [({call["tool"]}, {k: v for k, v in call.items() if k != "tool"}) for call in reply["calls"]]
    elif reply.get("action") == _OBSERVE:
        wanted = [({_OBSERVE}, {name: reply[name] for name in ("frame_id", "angle_deg")})]
    elif "answer" in reply:
        wanted = [({*_ANSWERS}, {name: value for name, value in reply.items() if name != "action"})]
    else:
        return []
    calls = []
    for number, (names, arguments) in enumerate(wanted):
        name = next((name for name in declared if name in names), None)
        if name is None:
            raise DecodeError(
                f"the simulated model calls {' or '.join(sorted(names))}, which the request does not declare"
            )
        if forced(choice) not in (None, name):
            raise DecodeError(f"the simulated model cannot be made to call {forced(choice)} in this turn")
        if unknown := set(declared[name].required) - set(arguments):
            raise DecodeError(f"the simulated model gives {name} no {', '.join(sorted(unknown))}")
        known = declared[name].properties or arguments
        sent = msgspec.json.encode({key: value for key, value in arguments.items() if key in known}).decode()
        function = {"name": name, "arguments": sent}
        calls.append({"id": f"call_{turn}_{number}", "type": "function", "function": function})
    return calls
