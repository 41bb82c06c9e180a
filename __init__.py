"""JRDB-AVR: active visual reasoning over JRDB, as a benchmark with proofs.

    import jrdb_avr as avr
    avr.load("jrdb/train_dataset_with_activity", "store")
    avr.generate("store")
    avr.evaluate("store", "react", "simulated", avr.EvaluateOptions(selection=avr.QuestionSelection(limit=20)))
    avr.report("store")

Scripts, programs from standard input and notebooks need no `if __name__ == "__main__":`, because worker processes do
not import them. The module of a public name is imported when the name is first used. `__init__.pyi` lists the public
names.

Each package imports only packages above it in this list, except that `agent` imports only `schema` and `queries`:

schema   the data model: plans, answers, tables, rules and errors
queries  the store with its SQL queries, and the graph with its Cypher queries
loaders  readers that turn JRDB files into annotation tables, intervals and the graph; the synthetic sample world
engine   generation of questions, proofs, observation, scoring, runs, reports and the command line
agent    methods that answer the questions
"""

import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, Final

if sys.version_info < (3, 11):  # noqa: UP036
    # pip refuses older versions, but a copy of the source would end with a traceback.
    sys.exit(f"jrdb-avr needs Python 3.11 or newer, and this is Python {sys.version.split()[0]}: use a newer one")
try:
    import fcntl  # noqa: F401
except ImportError:
    sys.exit("jrdb-avr needs the file locks of Linux or macOS: on Windows, install and run it in WSL")

__version__ = "0.2.0"

_STUB: Final = Path(__file__).with_suffix(".pyi")
_MODULES: Final[dict[str, str]] = {
    name: module for module, name in re.findall(r"^from (\S+) import (\w+) ", _STUB.read_text("utf-8"), flags=re.M)
}
"""Name of the module that defines each public name."""

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'jrdb_avr' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
