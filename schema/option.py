"""Declaration of options as fields of a dataclass.

The command line and the reader of TOML files both take names, limits and help texts from this declaration.
"""

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
        default: Default value. If it is a mapping, it must be empty.
        text: Help text.
        flag: Name of the option on the command line, without dashes. If it is "", the name of the field is used.
        minimum: Smallest allowed number; None for no limit.
        maximum: Largest allowed number; None for no limit.
        choices: Allowed texts. If there are none, every text is allowed.
        metavar: Placeholder for the value in help texts; None for the default of the command line.

    Returns:
        The dataclass field, with all arguments except `default` as metadata.
    """
    limits = {"minimum": minimum, "maximum": maximum, "choices": choices}
    metadata = {"text": text, "flag": flag, "metavar": metavar, **limits}
    if default == {}:
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)
