"""Find methods by name, as `evaluate --method` takes them: built-in methods and custom methods.

A custom method is FILE.py:NAME, or MODULE:NAME of an installed module. NAME is called with the chat client (None if the
run has no model) and returns a `schema.method.Method`. The run stores the result of its `settings()`, if it has
that function. A custom method is code of the user and has the user's rights.
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
"""Name of the model of a method that calls no model."""

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
"""Ways of an agent to choose its looks."""

DRIVABLE: Final = ("agent", "agent-no-world")
"""Methods that let the program choose looks, which is their default."""

CHATS: Final = ("react", "agent-no-world")
"""Methods that send all pictures again in every turn, if the model chooses the looks."""

WORLD_METHODS: Final = ("agent", "agent-passive")
"""Methods that write into a world model."""


def default_policy(method: object) -> Policy:
    """Return the policy of a method if the user names none."""
    return "driven" if method in DRIVABLE else "model"


@contextlib.contextmanager
def open_world(path: Path, run_id: str, record: pa.Table) -> Iterator[WorldModel]:
    """Yield the world model of a run in a graph file, and close it at the end of the block.

    Args:
        path: The graph file; it is made if it is missing.
        run_id: The id of the run.
        record: The world rows of the run so far; missing facts are restored first.

    Yields:
        The world model.

    Raises:
        LockedError: Another process has the graph open.
        StoreError: The graph cannot be opened.
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
    """Make a built-in method.

    Args:
        name: A name of `METHODS`.
        chat: The client of the model.
        convention: The convention of the model.
        world: The world model, for a method of `WORLD_METHODS`.
        policy: The policy of an agent; by default `default_policy`.
        history: The number of pictures that a method of `CHATS` sends; by default all.

    Returns:
        The method.
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
    """A method of the user; it has settings even if the user's class has none."""

    def __init__(self, spec: str, method: Any) -> None:
        if not callable(getattr(method, "answer", None)) or not isinstance(getattr(method, "name", None), str):
            raise InputError(
                f"{spec}: what it makes is no method: it needs a 'name' and 'answer(task)'", field="method"
            )
        self._spec = spec
        self._method = method

    @property
    def name(self) -> str:
        """The name of the method."""
        return str(self._method.name)

    def settings(self) -> dict[str, Any]:
        """Return the file or module of the method, and the settings that it reports."""
        settings: Any = getattr(self._method, "settings", dict)()
        return {"from": Path(self._spec).name, "settings": settings}

    def answer(self, task: Task) -> Prediction:
        """Answer one question."""
        prediction: Prediction = self._method.answer(task)
        return prediction


def is_custom(spec: str) -> bool:
    """Return whether the name of a method is FILE.py:NAME or MODULE:NAME."""
    return _SPEC.fullmatch(spec) is not None


def load_custom_method(spec: str, chat: Chat | None) -> CustomMethod:
    """Import and make a custom method.

    Args:
        spec: FILE.py:NAME or MODULE:NAME.
        chat: The client of the model, or None.

    Returns:
        The method.

    Raises:
        InputError: The method cannot be imported or made; the message has the reason.
    """
    match = _SPEC.fullmatch(spec)
    if match is None:
        raise InputError(f"{spec!r} is not a method: write FILE.py:NAME or MODULE:NAME", field="method")
    make: Callable[[Chat | None], Any] | None = getattr(_module(match["where"]), match["name"], None)
    if not callable(make):
        raise InputError(f"{match['where']} has no {match['name']} that can be called", field="method")
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
        # Because dataclasses of the file look up their module.
        sys.modules.setdefault(spec.name, module)
        spec.loader.exec_module(module)
    except FileNotFoundError:
        raise InputError(f"cannot read {where}: no such file", field="method") from None
    except (Exception, SystemExit) as error:
        raise InputError(f"cannot import {where} ({type(error).__name__}: {error})", field="method") from None
    return module
