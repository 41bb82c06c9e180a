"""JRDB-AVR: active visual reasoning over JRDB, as a benchmark with proofs.

    import jrdb_avr as avr
    avr.load("jrdb/train_dataset_with_activity", "store")
    avr.generate("store")
    avr.evaluate("store", "react", "marker")
    avr.report("store")

In a script these lines stand under `if __name__ == "__main__":`, as parts of the work run in processes that import it.
Names load on first use, so that the import itself is light. The packages below, from the bottom up:

schema   the data model: plans, answers, tables, rules, errors
queries  the store, SQL, and Cypher over its graph
loaders  JRDB files to annotation tables, intervals and the scene graph; the sample world
engine   generation, proofs, observation, scoring, runs, reports and the command line
agent    methods that take the benchmark (imports schema and queries only)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from jrdb_avr.agent.methods.episode import Episode as Episode
    from jrdb_avr.agent.model.options import EndpointOptions as EndpointOptions
    from jrdb_avr.engine.generate.run import Generation as Generation
    from jrdb_avr.engine.generate.run import generate as generate
    from jrdb_avr.engine.observe.observer import Observer as Observer
    from jrdb_avr.engine.report.comparison import Comparison as Comparison
    from jrdb_avr.engine.report.comparison import RunDifference as RunDifference
    from jrdb_avr.engine.report.comparison import Scores as Scores
    from jrdb_avr.engine.report.comparison import diff as diff
    from jrdb_avr.engine.report.comparison import report as report
    from jrdb_avr.engine.report.comparison import score as score
    from jrdb_avr.engine.run.bench import Bench as Bench
    from jrdb_avr.engine.run.evaluate import RunResult as RunResult
    from jrdb_avr.engine.run.evaluate import evaluate as evaluate
    from jrdb_avr.engine.run.judge import Judge as Judge
    from jrdb_avr.engine.run.live_scores import LiveScore as LiveScore
    from jrdb_avr.engine.run.options import EvaluateOptions as EvaluateOptions
    from jrdb_avr.engine.run.options import MethodOptions as MethodOptions
    from jrdb_avr.engine.run.options import QuestionSelection as QuestionSelection
    from jrdb_avr.engine.run.options import RunOptions as RunOptions
    from jrdb_avr.engine.validate.checks import Validation as Validation
    from jrdb_avr.engine.validate.checks import validate as validate
    from jrdb_avr.loaders.load import load as load
    from jrdb_avr.loaders.result import LoadResult as LoadResult
    from jrdb_avr.queries.store import Store as Store
    from jrdb_avr.schema.answers import Answer as Answer
    from jrdb_avr.schema.answers import Choice as Choice
    from jrdb_avr.schema.answers import Evidence as Evidence
    from jrdb_avr.schema.answers import FrameAnswer as FrameAnswer
    from jrdb_avr.schema.answers import FrameViewpoint as FrameViewpoint
    from jrdb_avr.schema.answers import Number as Number
    from jrdb_avr.schema.answers import Span as Span
    from jrdb_avr.schema.errors import AvrError as AvrError
    from jrdb_avr.schema.errors import AvrWarning as AvrWarning
    from jrdb_avr.schema.errors import DecodeError as DecodeError
    from jrdb_avr.schema.errors import EndpointError as EndpointError
    from jrdb_avr.schema.errors import InputError as InputError
    from jrdb_avr.schema.errors import LockedError as LockedError
    from jrdb_avr.schema.errors import ObserveError as ObserveError
    from jrdb_avr.schema.errors import PlanError as PlanError
    from jrdb_avr.schema.errors import QueryError as QueryError
    from jrdb_avr.schema.errors import RefusedError as RefusedError
    from jrdb_avr.schema.errors import RunStoppedError as RunStoppedError
    from jrdb_avr.schema.errors import StoreError as StoreError
    from jrdb_avr.schema.method import Method as Method
    from jrdb_avr.schema.method import Observation as Observation
    from jrdb_avr.schema.method import Panorama as Panorama
    from jrdb_avr.schema.method import Prediction as Prediction
    from jrdb_avr.schema.method import Question as Question
    from jrdb_avr.schema.method import SequenceInfo as SequenceInfo
    from jrdb_avr.schema.method import Step as Step
    from jrdb_avr.schema.method import Task as Task
    from jrdb_avr.schema.rules import LoadRules as LoadRules
    from jrdb_avr.schema.rules import Rules as Rules

__version__ = "0.1.0"

_NAMES: Final = {
    "loaders.load": ("load",),
    "engine.generate.run": ("generate", "Generation"),
    "engine.validate.checks": ("validate", "Validation"),
    "engine.run.evaluate": ("evaluate", "RunResult"),
    "engine.report.comparison": ("score", "report", "diff", "Scores", "Comparison", "RunDifference"),
    "queries.store": ("Store",),
    "engine.observe.observer": ("Observer",),
    "loaders.result": ("LoadResult",),
    "engine.run.live_scores": ("LiveScore",),
    "engine.run.options": ("EvaluateOptions", "QuestionSelection", "MethodOptions", "RunOptions"),
    "schema.rules": ("Rules", "LoadRules"),
    "agent.model.options": ("EndpointOptions",),
    "agent.methods.episode": ("Episode",),
    "engine.run.bench": ("Bench",),
    "engine.run.judge": ("Judge",),
    "schema.method": (
        "Method",
        "Task",
        "Question",
        "SequenceInfo",
        "Observation",
        "Panorama",
        "Step",
        "Prediction",
    ),
    "schema.answers": ("Answer", "Choice", "FrameAnswer", "Span", "FrameViewpoint", "Number", "Evidence"),
    "schema.errors": (
        "AvrError",
        "InputError",
        "StoreError",
        "LockedError",
        "QueryError",
        "PlanError",
        "ObserveError",
        "RefusedError",
        "DecodeError",
        "EndpointError",
        "RunStoppedError",
        "AvrWarning",
    ),
}
"""The public names by the module that defines them."""

_MODULES: Final = {name: f"jrdb_avr.{module}" for module, names in _NAMES.items() for name in names}

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'jrdb_avr' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
