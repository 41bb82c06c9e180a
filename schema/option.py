"""Declaration and check of options. Each option is a field of a dataclass.

The command line and the reader of TOML files both take names, limits and help texts from this declaration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Final, Literal

import msgspec

from jrdb_avr.schema.errors import InputError, did_you_mean

_SCALARS: Final = {"int": int, "float": float, "bool": bool, "str": str}
_TYPES: Final = {**_SCALARS, "tuple[str, ...]": tuple[str, ...], "tuple[int, int]": tuple[int, int]}
"""Types by annotation of a field. If a field has another annotation, its value is checked only against its choices."""


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
        default: Default value. A mapping must be empty.
        text: Help text.
        flag: Name of the option on the command line, without dashes. If it is "", the name of the field is used.
        minimum: Smallest allowed number, or None for no limit.
        maximum: Largest allowed number, or None for no limit.
        choices: Allowed texts. If there are none, every text is allowed.
        metavar: Placeholder for the value in help texts, or None for the placeholder that the command line chooses.

    Returns:
        The dataclass field, with all arguments except `default` as metadata.
    """
    limits = {"minimum": minimum, "maximum": maximum, "choices": tuple(choices)}
    about = {"text": text, "flag": flag, "metavar": metavar, **limits}
    return field(default_factory=dict, metadata=about) if default == {} else field(default=default, metadata=about)


@dataclass(frozen=True)
class Options:
    """Base of the dataclasses with declared options.

    Raises:
        InputError: If a value has the wrong type, is outside its limits, or is not one of its choices.
    """

    def __post_init__(self) -> None:
        for declared in fields(self):
            about, value, kind = declared.metadata, getattr(self, declared.name), str(declared.type)
            if about and not (value is None and "None" in kind):
                allowed: Any = Literal[about["choices"]] if about["choices"] else _TYPES.get(kind.split(" | ")[0], Any)
                try:
                    msgspec.convert(value, Annotated[allowed, msgspec.Meta(ge=about["minimum"], le=about["maximum"])])
                except msgspec.ValidationError as error:
                    hint = did_you_mean(str(value), about["choices"])
                    flag = about["flag"] or declared.name.replace("_", "-")
                    raise InputError(f"--{flag}: {error}{hint}", field=declared.name) from None
