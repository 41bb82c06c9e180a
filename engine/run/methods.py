"""Make a built-in or custom method from its name. The name is the value of `evaluate --method`.

The name of a custom method is FILE.py:NAME, or MODULE:NAME of an installed module. NAME is a function or a class. This
function or class is called with the chat client, or with None if the run has no model. It must return a
`schema.method.Method`. If the method has a function `settings()`, the run stores the settings that this function
returns. A custom method runs with all rights of the user.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from jrdb_avr.engine.run.options import DEFAULTS, MethodOptions
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.method import DIAGNOSTIC

if TYPE_CHECKING:
    from jrdb_avr.agent.methods.diagnostic import Pictures
    from jrdb_avr.agent.model.client import Chat
    from jrdb_avr.agent.model.conventions import Convention
    from jrdb_avr.agent.world.episode import WorldModel
    from jrdb_avr.schema.method import ConfigurableMethod, Method, Prediction, Task

NO_MODEL: Final = "none"
"""Name that a manifest has instead of the id of a model if the method of the run calls no model."""

BASELINES: Final = ("monolithic", "chain-of-thought", "search-recognize", "react")
"""Methods that have the set of prompts `paper`."""

METHODS: Final = (*BASELINES, "agent", "agent-passive", "agent-no-world", "agent-passive-no-world")

CHATS: Final = ("react", "agent-no-world")
"""Methods that send all pictures again in every turn."""

LOOKING: Final = ("react", "agent", "agent-no-world", "random-looks")
"""Methods with a budget of looks."""

WORLD_METHODS: Final = ("agent", "agent-passive")
"""Methods that write to a world model."""

ADVISED: Final = "agent"
"""The method with a world model that proposes looks."""


@contextlib.contextmanager
def open_world(folder: Path, run_id: str) -> Iterator[WorldModel]:
    """Yield the world model of a run. It has a graph file of its own, which is deleted at the end of the `with` block.

    Args:
        folder: The folder of the run.
        run_id: The id of the run.

    Yields:
        The world model.

    Raises:
        StoreError: If the graph file cannot be made.
    """
    from jrdb_avr.agent.world.episode import WorldModel
    from jrdb_avr.queries.beliefs.graph import WorldGraph
    from jrdb_avr.queries.graph.handle import remove_graph

    path = folder / "world.kuzu"
    # An interrupted run may have left a file. Its finished questions are in the journal.
    remove_graph(path)
    try:
        with WorldGraph.open(path) as world:
            yield WorldModel(world, run_id)
    finally:
        remove_graph(path)


def make_method(
    name: str,
    chat: Chat,
    convention: Convention,
    world: WorldModel | None = None,
    options: MethodOptions = DEFAULTS.method,
    pictures: Pictures | None = None,
) -> ConfigurableMethod:
    """Make a built-in method.

    Args:
        name: A name of `METHODS` or `DIAGNOSTIC`.
        chat: The client of the model.
        convention: How the model writes boxes.
        world: The world model, which a method of `WORLD_METHODS` needs.
        options: The options. Options of other methods have no effect.
        pictures: The function that returns the pictures of a question, which given-looks and given-target need.

    Returns:
        The method.
    """
    from jrdb_avr.agent.methods.chain_of_thought import ChainOfThought
    from jrdb_avr.agent.methods.diagnostic import Diagnostic, random_pictures
    from jrdb_avr.agent.methods.episode import BUDGET
    from jrdb_avr.agent.methods.monolithic import Monolithic
    from jrdb_avr.agent.methods.react import ReAct
    from jrdb_avr.agent.methods.search_recognize import SearchRecognize
    from jrdb_avr.agent.reference.loop import LIMITS
    from jrdb_avr.agent.reference.method import ReferenceAgent

    if name in WORLD_METHODS and world is None:
        raise ValueError(f"the method {name!r} needs a world model")
    if name.startswith("agent"):
        looks, advice = "passive" not in name, options.advice == "on"
        limits = replace(LIMITS, looks=options.looks or LIMITS.looks)
        return ReferenceAgent(chat, convention, world, looks, limits, advice, options.history)
    if name == ReAct.name:
        return ReAct(chat, convention, options.looks or BUDGET, history=options.history, prompts=options.prompts)
    if name in DIAGNOSTIC:
        budget = None if pictures else options.looks or BUDGET
        shown = pictures or random_pictures(options.looks or BUDGET)
        return Diagnostic(name, chat, shown, budget, name == "given-target", convention)
    kinds = (Monolithic, ChainOfThought, SearchRecognize)
    return next(kind for kind in kinds if kind.name == name)(chat, convention, prompts=options.prompts)


# -- custom methods ---------------------------------------------------------------------------------------------------

_SPEC: Final = re.compile(r"(?P<where>.+):(?P<name>[A-Za-z_][A-Za-z0-9_]*)")


class CustomMethod:
    """A custom method with the settings that a run records. The user's method need not have a function `settings()`."""

    def __init__(self, spec: str, method: Any) -> None:
        if not callable(getattr(method, "answer", None)) or not isinstance(getattr(method, "name", None), str):
            raise InputError(
                f"{spec} does not return a method: a method has a 'name' and 'answer(task)'", field="method"
            )
        self._spec = spec
        self._method: Method = method
        self.name = self._method.name

    def settings(self) -> dict[str, Any]:
        """Return the settings of the method.

        Returns:
            A dict with two keys. "from" is FILE.py:NAME without the folder of the file, or MODULE:NAME. "settings" is
            what the user's own function `settings()` returns, or an empty dict if there is no such function.
        """
        return {"from": Path(self._spec).name, "settings": getattr(self._method, "settings", dict)()}

    def answer(self, task: Task) -> Prediction:
        """Return the method's prediction for one question."""
        return self._method.answer(task)


def is_custom(spec: str) -> bool:
    """Return whether the name of a method has the form FILE.py:NAME or MODULE:NAME."""
    return _SPEC.fullmatch(spec) is not None


def load_custom_method(spec: str, chat: Chat | None) -> CustomMethod:
    """Import the function or class of a custom method, and call it with the chat client.

    Args:
        spec: FILE.py:NAME or MODULE:NAME.
        chat: The client of the model, or None if the run has no model.

    Returns:
        The method.

    Raises:
        InputError: If the import or the call fails. The message has the reason.
    """
    match = _SPEC.fullmatch(spec)
    if match is None:
        raise InputError(f"{spec!r} is not a method: write FILE.py:NAME or MODULE:NAME", field="method")
    make: Callable[[Chat | None], Any] | None = getattr(_module(match["where"]), match["name"], None)
    if not callable(make):
        raise InputError(f"{match['where']} has no function or class {match['name']}", field="method")
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
        # The module is registered, because a dataclass in the file looks up its own module in `sys.modules`.
        sys.modules.setdefault(spec.name, module)
        spec.loader.exec_module(module)
    except FileNotFoundError:
        raise InputError(f"cannot read {where}: no such file", field="method") from None
    except (Exception, SystemExit) as error:
        raise InputError(f"cannot import {where} ({type(error).__name__}: {error})", field="method") from None
    return module
