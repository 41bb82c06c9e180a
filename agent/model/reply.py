"""Read a server's reply: its fields, the reason if it reports an error, its text, and its thinking."""

from __future__ import annotations

import json
import re
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.conventions import Convention

_MOST_TOKENS: Final = 1 << 40
_LONGEST_NAME: Final = 200


class Reply(msgspec.Struct, frozen=True, omit_defaults=True):
    """A reply of a chat server.

    content, reasoning: the texts as sent. finish_reason: why the reply ended. model: the model id that the reply names.
    prompt_tokens, completion_tokens: the numbers of tokens that the server counted, 0 if unknown. refusal: the text
    with which the model declines to answer. estimated: whether the client estimated the numbers of tokens, because the
    server counted none.
    """

    content: str = ""
    reasoning: str = ""
    finish_reason: str = ""
    model: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    refusal: str = ""
    estimated: bool = False

    @property
    def finished(self) -> bool:
        """Whether the server says that the reply ended, the reply was not cut off, and it is not a refusal."""
        return self.finish_reason not in ("", "length", "content_filter") and not self.refusal


class ErrorReply(ValueError):  # noqa: N818 - it is a reply
    """A reply that reports an error instead of a completion.

    status: the HTTP status. reason: the server's text for the error. code: the server's code for the error, or None.
    """

    def __init__(self, status: int, reason: str, code: object = None) -> None:
        super().__init__(reason)
        self.reason, self.code = reason, code
        # Some servers and proxies send an error with the status of a success.
        nested = code if isinstance(code, int) and 400 <= code < 600 else 502
        self.status = nested if 200 <= status < 300 else status


class _Text(msgspec.Struct):
    content: str | list[Any] | None = None
    reasoning: Any = None
    reasoning_content: Any = None
    refusal: Any = None


class _Choice(msgspec.Struct):
    message: _Text
    finish_reason: Any = None
    error: Any = None


class _Completion(msgspec.Struct):
    choices: list[_Choice]
    model: Any = None
    usage: Any = None


# This runs at import, because msgspec crashes if several threads make the first decoder of a type at the same time.
msgspec.convert({"choices": []}, _Completion)

_ENDS: Final = {
    "content_filter": "content_?(filter|policy)|safety|sensitive|recitation|prohibited|refusal|guardrail|moderat|toxic"
    "|policy_violation|blocked|blocklist|spii",
    "failed": "(?<!no_)error|abort|cancel|fail|insufficient|time_?d?_?out|unavailable|overload|capacity|interrupt"
    "|disconnect|busy|shut_?down|crash|exception|memory|^oom|kill|died|preempt|evict|terminated|reset|deadline|throttl"
    "|rate_?limit|too_many(?!_tokens)|quota|gateway|upstream|^5[0-9][0-9]$",
    "length": "length|max_?(new_?|output_?|completion_?)?tokens|too_many_tokens|token_?limit|context_window",
    "stop": "^(stop|eos|eos_token|end_turn|stop_sequence)$",
}
"""Ends of replies by regular expressions for finish reasons. Some servers use finish reasons of other protocols.

"failed" means that the server broke off the reply, for example "insufficient_system_resource".
"""

_ESCAPE: Final = re.compile(r"\\(?:u[dD][89abAB]\w{2}\\u[dD][c-fC-F]\w{2}|(u[dD][89a-fA-F]\w{2})|.)")
"""An escape of JSON, or a pair of surrogates. The group is a lone surrogate."""


def read_completion(data: bytes, status: int = 200) -> Reply:
    """Read the first choice of a chat completion.

    Args:
        data: The body of the reply.
        status: The HTTP status of the reply.

    Returns:
        The reply.

    Raises:
        ErrorReply: If the status or the body reports an error.
        ValueError: If the body is not a chat completion.
    """
    failed = not 200 <= status < 300
    # Lone surrogates, and bytes that are not UTF-8, become U+FFFD, because no file could hold them.
    text = _ESCAPE.sub(lambda match: r"\ufffd" if match[1] else match[0], data.decode("utf-8-sig", "replace"))
    try:
        # NaN and Infinity are not JSON, but some servers write them into fields that are not read here.
        body = json.loads(text, parse_constant=lambda name: None)
    except (ValueError, RecursionError) as error:
        if not failed:
            raise ValueError(str(error)) from None
        body = None
    if failed or (isinstance(body, dict) and (body.get("error") or body.get("object") == "error")):
        reason, code = _reason(body)
        raise ErrorReply(status, text if reason is None else reason, code)
    try:
        completion = msgspec.convert(body, _Completion)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
    if not completion.choices:
        raise ValueError("it holds no choice")
    choice = completion.choices[0]
    # Some gateways send the reason in a list or an object.
    ended = str(choice.finish_reason or "").strip()
    plain = re.sub("[ -]", "_", ended.lower()).removeprefix("finish_reason_")
    end = next((end for end, form in _ENDS.items() if re.search(form, plain)), _text(choice.finish_reason).strip())
    if choice.error or end == "failed":
        reason, code = _reason(choice.error)
        raise ErrorReply(status, reason or f"the reply ended with finish_reason {ended!a}", code)
    message = choice.message
    content, thinking = _parts(message.content)
    return Reply(
        content=content,
        reasoning=_text(message.reasoning_content) or _text(message.reasoning) or thinking,
        finish_reason=end,
        model=_text(completion.model)[:_LONGEST_NAME],
        prompt_tokens=_tokens(completion.usage, "prompt|input"),
        completion_tokens=_tokens(completion.usage, "completion|output|candidates"),
        refusal=_text(message.refusal),
    )


def _reason(body: object) -> tuple[str | None, object]:
    """Return the reason and the code of an error. They may be nested under `error`, `message`, `detail` or `msg`."""
    code = None
    while not isinstance(body, str):
        match body:
            case [first, *_]:
                body = first
            case {"msg": str(fault), "loc": [*path]}:
                body = f"{'.'.join(map(str, path))}: {fault}"
            case dict():
                code = (body.get("code") or body.get("type")) if code is None else code
                nested = [body.get(key) for key in ("error", "message", "detail", "msg")]
                body = next((value for value in nested if value and isinstance(value, str | list | dict)), None)
            case _:
                return None, code
    return body, code


def _parts(content: str | list[Any] | None) -> tuple[str, str]:
    """Return the text and the thinking of a reply. Some servers send both as one list of parts."""
    texts: list[str] = []
    thoughts: list[str] = []
    for part in content if isinstance(content, list) else [content]:
        match part:
            case str():
                texts.append(part)
            case {"text": str(text), **rest} if rest.get("type", "text") in ("text", "output_text"):
                texts.append(text)
            case {"type": "thinking" | "reasoning", "thinking": str(text)}:
                thoughts.append(text)
            case {"type": "thinking" | "reasoning", "thinking": [*inner]}:
                thoughts.append(_parts(inner)[0])
    return "".join(texts), "".join(thoughts)


def _text(value: object) -> str:
    """Return a text field, or "" if its value is not a text."""
    return value if isinstance(value, str) else ""


def _tokens(usage: object, names: str) -> int:
    """Return a count of tokens. If it is missing or invalid, return 0, because the reply itself may be valid."""
    form = re.compile(rf"(?i)({names})_?tokens?(_?count)?")
    counts = [count for name, count in usage.items() if form.fullmatch(name)] if isinstance(usage, dict) else []
    return next((int(n) for n in counts if type(n) in (int, float) and 0 < n <= _MOST_TOKENS and n % 1 == 0), 0)


def answer_text(reply: Reply, convention: Convention) -> str:
    """Return the text of a reply without its thinking.

    Args:
        reply: The reply. If a server sends the whole reply as `reasoning`, the text after the closing delimiter is
            used.
        convention: The convention, for the delimiters of thinking.

    Returns:
        The text. It is empty if the reply holds only thinking.
    """
    text = _after_thinking(reply.content, convention)
    if not text and any(close in reply.reasoning for _, close in convention.thinking):
        text = _after_thinking(reply.reasoning, convention)
    return text


def thinking_text(reply: Reply, convention: Convention) -> str:
    """Return the thinking of a reply.

    Args:
        reply: The reply.
        convention: The convention, for the delimiters of thinking.

    Returns:
        The thinking without delimiters. It is empty if the reply holds only an answer.
    """
    for text in (reply.content, reply.reasoning):
        for opening, closing in convention.thinking:
            # If the chat template holds the opening delimiter, the reply has only the closing delimiter.
            before, closed, _ = text.rpartition(closing)
            inner = before if closed else text if text.lstrip().startswith(opening) else ""
            if thinking := inner.replace(opening, "").strip():
                return thinking
    return reply.reasoning.strip() if not any(close in reply.reasoning for _, close in convention.thinking) else ""


def _after_thinking(text: str, convention: Convention) -> str:
    # The end of a turn may also be the end of thinking, so it is removed first.
    text = _between(text, convention)
    for opening, closing in convention.thinking:
        text = _without_blocks(text, opening, closing)
    return _between(text, convention)


def _between(text: str, convention: Convention) -> str:
    """Return the text without the delimiters around an answer."""
    text = text.strip()
    for delimiter in convention.around:
        text = text.removeprefix(delimiter).removesuffix(delimiter).strip()
    return text


def _without_blocks(text: str, opening: str, closing: str) -> str:
    """Return the text outside of thinking. It is empty if the reply holds only thinking.

    Text before a block of thinking stays, because a reply with an answer before and after a block must be refused. If
    the opening delimiter is missing, everything before the closing delimiter is thinking. An opening delimiter that
    follows text and is never closed counts as text.
    """
    texts: list[str] = []
    *blocks, last = text.split(closing)
    for block in blocks:
        before, opened, _ = block.partition(opening)
        if not opened:
            texts.clear()
        texts.append(before if opened else "")
    outside = "".join(texts)
    before, opened, _ = last.partition(opening)
    return outside if opened and not (outside + before).strip() else outside + last
