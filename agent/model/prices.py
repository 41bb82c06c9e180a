"""Estimates of tokens, and prices of models, in dollars per million tokens, from a TOML file.

["Qwen/Qwen3-VL-8B-Instruct"]
input = 0.1
output = 0.4
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.messages import Message, Picture
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.errors import InputError

Dollars = Annotated[float, msgspec.Meta(ge=0, le=1e6)]

_CHARACTERS: Final = 4
"""Usual number of characters per token."""


@dataclass(frozen=True)
class Price:
    """The prices of a model.

    input: dollars per million tokens that the model reads. output: dollars per million tokens that the model writes.
    """

    input: Dollars
    output: Dollars

    def cost(self, prompt_tokens: int, completion_tokens: int) -> float:
        """Return the cost of tokens.

        Args:
            prompt_tokens: Number of tokens that the model reads.
            completion_tokens: Number of tokens that the model writes.

        Returns:
            The cost in dollars.
        """
        return (prompt_tokens * self.input + completion_tokens * self.output) / 1e6


def estimate_tokens(messages: Sequence[Message], convention: Convention) -> int:
    """Estimate the number of tokens of a chat: a token per four characters, and the tokens of each picture.

    Args:
        messages: The chat.
        convention: The convention of the model, which may declare how many tokens a picture has.

    Returns:
        The estimated number of tokens.
    """
    parts = [part for message in messages for part in message.parts]
    sizes = [part.size for part in parts if isinstance(part, Picture)]
    # If the convention does not declare the resizing, a token has 28 x 28 pixels.
    pictures = (convention.picture_tokens(*size) or size[0] * size[1] / 28**2 for size in sizes)
    return round(sum(len(part) for part in parts if isinstance(part, str)) / _CHARACTERS + sum(pictures))


def with_tokens(reply: Reply, messages: Sequence[Message], convention: Convention) -> Reply:
    """Estimate the numbers of tokens that a server does not count.

    Args:
        reply: The reply of the server.
        messages: The chat of the request.
        convention: The convention of the model.

    Returns:
        The reply with both numbers. If the server counted both, the reply is unchanged.
    """
    written = -(-len(reply.content + reply.reasoning) // _CHARACTERS)
    if reply.prompt_tokens and (reply.completion_tokens or not written):
        return reply
    prompt_tokens = reply.prompt_tokens or estimate_tokens(messages, convention)
    counts = {"prompt_tokens": prompt_tokens, "completion_tokens": reply.completion_tokens or written}
    return msgspec.structs.replace(reply, **counts, estimated=True)


def read_price(data: bytes, path: Path, model: str) -> Price:
    """Read the price of a model.

    Args:
        data: The content of a TOML file of prices, in UTF-8.
        path: The path of the file, for messages.
        model: The model id.

    Returns:
        The price.

    Raises:
        InputError: If the file cannot be read or does not name the model's price.
    """
    try:
        prices = msgspec.toml.decode(data, type=dict[str, Any])
    except (UnicodeDecodeError, msgspec.DecodeError, RecursionError) as error:
        raise InputError(f"cannot read the prices in {path}: {error}", file=str(path)) from None
    try:
        return msgspec.convert(prices.get(model), Price)
    except msgspec.ValidationError:
        raise InputError(
            f'{path} has no price of {model}: write ["{model}"] and below it input = and output = in dollars per '
            "million tokens",
            file=str(path),
        ) from None
