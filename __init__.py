"""JRDB-AVR: active visual reasoning over JRDB, as a benchmark with proofs.

    import jrdb_avr as avr
    avr.load("jrdb/train_dataset_with_activity", "store")
    avr.generate("store")
    avr.evaluate("store", "react", "marker", avr.EvaluateOptions(selection=avr.QuestionSelection(limit=20)))
    avr.report("store")

In a script, put these lines under `if __name__ == "__main__":`, because parts of the work run in processes that import
the script. A name loads its module on first use. `__init__.pyi` lists all names. The packages, from the bottom up:

schema   the data model: plans, answers, tables, rules, errors
queries  the store, SQL, and Cypher over its graph
loaders  JRDB files to annotation tables, intervals and the scene graph; the sample world
engine   generation, proofs, observation, scoring, runs, reports and the command line
agent    methods that answer the questions (imports schema and queries only)
"""

import re
from importlib import import_module
from pathlib import Path
from typing import Any, Final

__version__ = "0.1.0"

_STUB: Final = Path(__file__).with_suffix(".pyi")
_MODULES: Final[dict[str, str]] = {
    name: module for module, name in re.findall(r"^from (\S+) import (\w+) ", _STUB.read_text("utf-8"), flags=re.M)
}
"""Module of each public name."""

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'jrdb_avr' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
