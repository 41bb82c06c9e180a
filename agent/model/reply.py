"""A server's reply: its fields, how to read it from a chat completion, and its text without the thinking."""

from __future__ import annotations

import re
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.conventions import Convention

_MOST_TOKENS: Final = 1 << 40
_LONGEST_NAME: Final = 200


class Reply(msgspec.Struct, frozen=True, omit_defaults=True):
    """One reply: text fields as sent, why it stopped, token counts, and the model id that it names.

    `refusal` holds the text of a model that declines to answer.
    """

    content: str = ""
    reasoning: str = ""
    finish_reason: str = ""
    model: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    refusal: str = ""

    @property
    def finished(self) -> bool:
        """Whether the reply ended by itself, and was not refused."""
        return self.finish_reason == "stop" and not self.refusal


class _Text(msgspec.Struct):
    content: str | None = None
    reasoning: Any = None
    reasoning_content: Any = None
    refusal: Any = None


class _Choice(msgspec.Struct):
    message: _Text
    finish_reason: str | None = None


class _Completion(msgspec.Struct):
    choices: list[_Choice]
    model: str | None = None
    usage: Any = None


# Made at import: threads that meet a type first at the same time crash the decoder.
_COMPLETION: Final = msgspec.json.Decoder(_Completion)


def read_completion(data: bytes) -> Reply:
    """The first choice of a chat completion. Raises ValueError with the reason for anything else."""
    try:
        completion = _COMPLETION.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(str(error) or "nested too deep") from None
    if not completion.choices:
        raise ValueError("it holds no choice")
    choice = completion.choices[0]
    text = choice.message
    return Reply(
        content=text.content or "",
        reasoning=_text(text.reasoning_content) or _text(text.reasoning),
        finish_reason=choice.finish_reason or "",
        model=(completion.model or "")[:_LONGEST_NAME],
        prompt_tokens=_tokens(completion.usage, "prompt_tokens"),
        completion_tokens=_tokens(completion.usage, "completion_tokens"),
        refusal=_text(text.refusal),
    )


def _text(value: object) -> str:
    """A field that some servers fill with other things than text."""
    return value if isinstance(value, str) else ""


def _tokens(usage: object, name: str) -> int:
    """A count of tokens; 0 where the server sends none, or nonsense: a good reply is not refused for it."""
    count = usage.get(name) if isinstance(usage, dict) else None
    return count if type(count) is int and 0 <= count <= _MOST_TOKENS else 0


def spoken(reply: Reply, convention: Convention) -> str:
    """The reply's text after any thinking; empty where it only thinks, or holds nothing.

    Some servers file the whole reply under `reasoning`: its text counts past a closing delimiter, never the thinking
    itself.
    """
    text = _after_thinking(reply.content, convention)
    if not text and any(close in reply.reasoning for _, close in convention.thinking):
        text = _after_thinking(reply.reasoning, convention)
    return text


def thought(reply: Reply, convention: Convention) -> str:
    """The thinking in a reply, without delimiters; empty where there is none, or an empty block of it."""
    for text in (reply.content, reply.reasoning):
        for opening, closing in convention.thinking:
            # The opening delimiter may stand in the server's template instead of the reply.
            before, closed, _ = text.rpartition(closing)
            inner = before if closed else text if text.lstrip().startswith(opening) else ""
            if words := inner.replace(opening, "").strip():
                return words
    return reply.reasoning.strip() if not any(close in reply.reasoning for _, close in convention.thinking) else ""


def _after_thinking(text: str, convention: Convention) -> str:
    for opening, closing in convention.thinking:
        text = _without_blocks(text, opening, closing)
    return text.strip()


def _without_blocks(text: str, opening: str, closing: str) -> str:
    """The text outside of thinking; empty where the reply only thinks.

    Text before a block stays: a reply that answers, thinks and answers again holds two answers. The opening delimiter
    may stand in the server's template instead of the reply: then everything before the closing one is thinking. A
    delimiter that is never closed begins no thinking after text.
    """
    texts: list[str] = []
    start, thinks = 0, False
    # One pass: replies are long, and the delimiters in them many.
    for found in re.finditer(f"{re.escape(opening)}|{re.escape(closing)}", text):
        if found[0] == closing:
            if not thinks:
                texts = []
            start, thinks = found.end(), False
        elif not thinks:
            texts.append(text[start : found.start()])
            start, thinks = found.start(), True
    words = "".join(texts)
    return words if thinks and not words.strip() else words + text[start:]
