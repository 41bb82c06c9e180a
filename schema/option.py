"""Declaration of options: a field of an options class holds all that the command line and a TOML file need."""

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
        default: The default value. A default mapping must be empty.
        text: The help text of the option.
        flag: The long name on the command line, without dashes. Default: the name of the field, with hyphens.
        minimum: The smallest allowed number; None for no minimum.
        maximum: The largest allowed number; None for no maximum.
        choices: The allowed values; if empty, any value is allowed.
        metavar: The placeholder of the value in help texts; None for the default of the value's type.

    Returns:
        A dataclass field with this default. Its metadata holds the other arguments.
    """
    limits = {"minimum": minimum, "maximum": maximum, "choices": choices}
    metadata = {"text": text, "flag": flag, "metavar": metavar, **limits}
    if default == {}:
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)
