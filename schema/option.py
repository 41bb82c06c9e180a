"""Declarations of options: each field of an options class states once what a command line and a TOML file need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final

_KEY: Final = "option"
"""Key of a declaration in the metadata of a field."""


@dataclass(frozen=True, slots=True)
class Declaration:
    """Help text and limits of an option; its name, type and default are those of its field."""

    text: str
    flag: str
    minimum: int | None
    maximum: int | None
    choices: tuple[str, ...]
    metavar: str | None


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
        The field.
    """
    metadata = {_KEY: Declaration(text, flag, minimum, maximum, tuple(choices), metavar)}
    if default == {}:
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)


def declared_options(kind: Any) -> dict[str, tuple[Declaration, str, Any]]:
    """Return the declared options of an options class.

    Args:
        kind: A dataclass whose fields are made by `option`.

    Returns:
        By field name: the declaration with its flag, the type as text, and the default.
    """
    found = {}
    for own in fields(kind):
        if (declared := own.metadata.get(_KEY)) is not None:
            flag = declared.flag or own.name.replace("_", "-")
            values = {name: getattr(declared, name) for name in declared.__slots__} | {"flag": flag}
            found[own.name] = (Declaration(**values), str(own.type), getattr(kind, own.name, {}))
    return found
