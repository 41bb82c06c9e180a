"""Methods by name, as `evaluate --method` takes them: the built-in ones and custom ones.

A custom method is FILE.py:NAME, or MODULE:NAME of an installed module. NAME is called with the chat client, or None
where the run has no model, and returns a `schema.method.Method`; its `settings()`, if it has them, are stored with the
run. It is the user's own code and runs as such.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from jrdb_avr.schema.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from jrdb_avr.agent.beliefs.world_model import WorldModel
    from jrdb_avr.agent.model.client import Chat
    from jrdb_avr.agent.model.conventions import Convention
    from jrdb_avr.agent.reference.method import Policy
    from jrdb_avr.schema.method import ConfigurableMethod, Prediction, Task

NO_MODEL: Final = "none"
"""The model of a custom method that calls none."""

METHODS: Final = (
    "monolithic",
    "chain-of-thought",
    "search-recognize",
    "react",
    "agent",
    "agent-passive",
    "agent-no-world",
    "agent-passive-no-world",
)

POLICIES: Final = ("model", "guided", "driven")
"""Who chooses the looks of an agent."""

DRIVABLE: Final = ("agent", "agent-no-world")
"""Methods whose looks the harness may choose, as it does unless something else is asked for."""

CHATS: Final = ("react", "agent-no-world")
"""Methods that send their pictures again in every turn, if the model chooses the looks."""

WORLD_METHODS: Final = ("agent", "agent-passive")
"""Methods that write into a world model."""


def default_policy(method: object) -> Policy:
    """The policy of a method where none is asked for."""
    return "driven" if method in DRIVABLE else "model"


@contextlib.contextmanager
def open_world(path: Path, run_id: str, record: pa.Table) -> Iterator[WorldModel]:
    """A run's world model in the graph file at `path`, which is made if there is none; closed at the end of the block.

    record: the run's world rows so far; what the graph lacks of them is brought back first. Raises LockedError where
    another process has the graph open, StoreError where it cannot be opened.
    """
    from jrdb_avr.agent.beliefs.world_model import WorldModel
    from jrdb_avr.queries.beliefs.graph import WorldGraph, open_graph
    from jrdb_avr.queries.beliefs.record import restore_world

    with open_graph(path) as graph:
        restore_world(graph, run_id, record)
    with WorldGraph.open(path) as world:
        yield WorldModel(world, run_id)


def make_method(
    name: str,
    chat: Chat,
    convention: Convention,
    world: WorldModel | None = None,
    policy: Policy | None = None,
    history: int | None = None,
) -> ConfigurableMethod:
    """The method of a name in `METHODS`.

    One of `WORLD_METHODS` takes its world model; agents take a policy, `default_policy` without; one of `CHATS`, where
    the model chooses its looks, how many pictures it sends.
    """
    from jrdb_avr.agent.methods.chain_of_thought import ChainOfThought
    from jrdb_avr.agent.methods.monolithic import Monolithic
    from jrdb_avr.agent.methods.react import ReAct
    from jrdb_avr.agent.methods.search_recognize import SearchRecognize
    from jrdb_avr.agent.reference.method import ReferenceAgent

    if name in WORLD_METHODS and world is None:
        raise ValueError(f"the method {name!r} needs a world model")
    if name.startswith("agent"):
        return ReferenceAgent(
            chat, convention, world, looks="passive" not in name, policy=policy or default_policy(name), history=history
        )
    if name == ReAct.name:
        return ReAct(chat, convention, history=history)
    kinds = (Monolithic, ChainOfThought, SearchRecognize)
    return next(kind for kind in kinds if kind.name == name)(chat, convention)


# -- custom methods ---------------------------------------------------------------------------------------------------

_SPEC: Final = re.compile(r"(?P<where>.+):(?P<name>[A-Za-z_][A-Za-z0-9_]*)")


class CustomMethod:
    """A user's method, with settings whether or not it has any of its own."""

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
        """The file or module of the method, and the settings that it reports."""
        own: Any = getattr(self._method, "settings", dict)()
        return {"from": Path(self._spec).name, "settings": own}

    def answer(self, task: Task) -> Prediction:
        prediction: Prediction = self._method.answer(task)
        return prediction


def is_custom(spec: str) -> bool:
    """Whether a method's name is FILE.py:NAME or MODULE:NAME."""
    return _SPEC.fullmatch(spec) is not None


def load_custom_method(spec: str, chat: Chat | None) -> CustomMethod:
    """Import and make a custom method. Raises InputError with the reason where that fails."""
    found = _SPEC.fullmatch(spec)
    if found is None:
        raise InputError(f"{spec!r} is no method: write FILE.py:NAME or MODULE:NAME", field="method")
    make: Callable[[Chat | None], Any] | None = getattr(_module(found["where"]), found["name"], None)
    if not callable(make):
        raise InputError(f"{found['where']} has no {found['name']} that can be called", field="method")
    try:
        return CustomMethod(spec, make(chat))
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        why = error if isinstance(error, TypeError) else f"{type(error).__name__}: {error}"
        raise InputError(f"{spec} cannot be made ({why}): it is called with the chat client", field="method") from None


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
    except (Exception, SystemExit) as error:
        raise InputError(f"cannot import {where} ({type(error).__name__}: {error})", field="method") from None
    return module
