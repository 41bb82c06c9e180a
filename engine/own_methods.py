"""Methods of somebody's own: `evaluate --method FILE.py:NAME`, or `MODULE:NAME` of what is installed.

NAME is called with the chat client, or None where the run has no model, and returns a `schema.method.Method`; its
`settings()`, if it has them, are kept with the run. It is code of the user's own, run as such.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from jrdb_avr.schema.errors import InputError

if TYPE_CHECKING:
    from jrdb_avr.agent.client import Chat
    from jrdb_avr.schema.method import Prediction, Task

_SPEC: Final = re.compile(r"(?P<where>.+):(?P<name>[A-Za-z_][A-Za-z0-9_]*)")


class OwnMethod:
    """A method of somebody's own, with settings whether or not it has any."""

    def __init__(self, spec: str, method: Any) -> None:
        if not callable(getattr(method, "answer", None)) or not isinstance(getattr(method, "name", None), str):
            raise InputError(
                f"{spec}: what it makes is no method: it needs a 'name' and 'answer(task)'", field="method"
            )
        self._spec = spec
        self._method = method

    @property
    def name(self) -> str:
        return str(self._method.name)

    def settings(self) -> dict[str, Any]:
        """Where the method came from, and what it says of itself."""
        own: Any = getattr(self._method, "settings", dict)()
        return {"from": Path(self._spec).name, "settings": own}

    def answer(self, task: Task) -> Prediction:
        prediction: Prediction = self._method.answer(task)
        return prediction


def is_own(spec: str) -> bool:
    """Whether the name of a method names somebody's own."""
    return _SPEC.fullmatch(spec) is not None


def own_method(spec: str, chat: Chat | None) -> OwnMethod:
    """Make the method. Raises InputError, saying what is wrong, where it cannot be imported or made."""
    found = _SPEC.fullmatch(spec)
    if found is None:
        raise InputError(f"{spec!r} is no method: write FILE.py:NAME or MODULE:NAME", field="method")
    make: Callable[[Chat | None], Any] | None = getattr(_module(found["where"]), found["name"], None)
    if not callable(make):
        raise InputError(f"{found['where']} has no {found['name']} that can be called", field="method")
    try:
        return OwnMethod(spec, make(chat))
    except TypeError as error:
        raise InputError(
            f"{spec} cannot be made ({error}): it is called with the chat client", field="method"
        ) from None


def _module(where: str) -> ModuleType:
    try:
        if not where.endswith(".py"):
            return importlib.import_module(where)
        spec = importlib.util.spec_from_file_location(Path(where).stem, where)
        assert spec is not None and spec.loader is not None, "the name ends in .py"
        module = importlib.util.module_from_spec(spec)
        # Dataclasses of the file look their module up.
        sys.modules.setdefault(spec.name, module)
        spec.loader.exec_module(module)
    except FileNotFoundError:
        raise InputError(f"cannot read {where}: no such file", field="method") from None
    except Exception as error:
        raise InputError(f"cannot import {where} ({type(error).__name__}: {error})", field="method") from None
    return module
