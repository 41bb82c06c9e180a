"""Prices of models, in dollars per million tokens, from a TOML file.

["Qwen/Qwen3-VL-8B-Instruct"]
input = 0.1
output = 0.4
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec

from jrdb_avr.schema.errors import InputError

Dollars = Annotated[float, msgspec.Meta(ge=0, le=1e6)]


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


def read_price(path: Path, model: str) -> Price:
    """Read the price of a model.

    Args:
        path: A TOML file of prices.
        model: The model id.

    Returns:
        The price.

    Raises:
        InputError: If the file cannot be read or does not name the model's price.
    """
    try:
        prices = msgspec.toml.decode(path.read_bytes(), type=dict[str, Any])
    except (OSError, UnicodeDecodeError, msgspec.DecodeError, RecursionError) as error:
        raise InputError(f"cannot read the prices in {path}: {error}", file=str(path)) from None
    try:
        return msgspec.convert(prices.get(model), Price)
    except msgspec.ValidationError:
        raise InputError(
            f'{path} has no price of {model}: write ["{model}"] and below it input = and output = in dollars per '
            "million tokens",
            file=str(path),
        ) from None
