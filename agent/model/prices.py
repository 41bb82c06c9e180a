"""Prices of models, in dollars per million tokens, from a TOML file.

["Qwen/Qwen3-VL-8B-Instruct"]
input = 0.1
output = 0.4
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

from jrdb_avr.schema.errors import InputError


@dataclass(frozen=True)
class Price:
    """The price in dollars of a million tokens that a model reads (`input`) or writes (`output`)."""

    input: float
    output: float

    def cost(self, prompt_tokens: int, completion_tokens: int) -> float:
        """Return the cost of tokens.

        Args:
            prompt_tokens: The tokens that the model reads.
            completion_tokens: The tokens that it writes.

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
        InputError: The file cannot be read or does not name the model's price.
    """
    try:
        entry = tomllib.loads(path.read_text(encoding="utf-8")).get(model)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"cannot read the prices in {path}: {error}", file=str(path)) from None
    match entry:
        case {"input": int() | float() as read, "output": int() | float() as written} if _is_price(read, written):
            return Price(float(read), float(written))
    raise InputError(
        f'{path} has no price of {model}: write ["{model}"] and below it input = and output = in dollars per million '
        "tokens",
        file=str(path),
    )


def _is_price(*values: float) -> bool:
    return all(not isinstance(value, bool) and 0 <= value < math.inf for value in values)
