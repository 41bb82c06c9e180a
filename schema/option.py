"""Declare options: each field of an options class states once what a command line and a TOML file need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Any


def option(
    default: Any,
    text: str,
    *,
    flag: str = "",
    minimum: int | None = None,
    maximum: int | None = None,
    choices: Sequence[str] = (),
    metavar: str | None = None,
) -> Any:
    """Declare an option as a field of a dataclass.

    Args:
        default: The default value; a mapping must be empty.
        text: The help text.
        flag: The long name without dashes; by default the name of the field.
        minimum: The smallest allowed number.
        maximum: The largest allowed number.
        choices: The allowed texts; by default all.
        metavar: The placeholder of the value in help texts.

    Returns:
        The field, with the other arguments as its metadata.
    """
    limits = {"minimum": minimum, "maximum": maximum, "choices": choices}
    metadata = {"text": text, "flag": flag, "metavar": metavar, **limits}
    if default == {}:
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)
