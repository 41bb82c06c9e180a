"""Options of a run, grouped by subject. The library, the command line and TOML files of runs share these classes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, Literal, get_args

from jrdb_avr.agent.model.options import DEFAULTS as DEFAULT_ENDPOINT
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.prompts import PromptSet
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.option import Options, option


@dataclass(frozen=True, kw_only=True)
class QuestionSelection(Options):
    """Options that select the questions of a run. The default is all questions.

    A tuple that is not empty is a filter: it lists the permitted values. If there are several filters, a question must
    match all of them. The same options always select the same questions of a store. A larger `limit` or `per_template`
    only adds questions to the selection, so that a run can grow.
    """

    questions: tuple[str, ...] = option((), "Ids of questions, separated by commas, or a file with one id per line.")
    families: tuple[str, ...] = option((), "Only questions of this family. May be repeated.", flag="family")
    templates: tuple[str, ...] = option((), "Only questions of this template. May be repeated.", flag="template")
    sequences: tuple[str, ...] = option((), "Only questions of this sequence. May be repeated.", flag="sequence")
    per_template: int | None = option(
        None,
        "Maximum number of questions per template. With --limit, the templates take turns until the limit is reached.",
        minimum=1,
        metavar="N",
    )
    limit: int | None = option(
        None, "Maximum number of questions. Questions without panoramas do not count.", minimum=1, metavar="N"
    )
    seed: int | None = option(None, "Take questions in the random order of this seed. Default: the order of the store.")
    shard: tuple[int, int] | None = option(
        None,
        "Sort the sequences by name. Answer the selected questions of the Ith sequence and of each Nth sequence after "
        "it. The name of the run ends in -IofN. 'runs merge' makes one run of all N shards.",
        metavar="I/N",
    )

    @classmethod
    def of(cls, questions: QuestionSelection | Iterable[str] | None, limit: int | None = None) -> QuestionSelection:
        """Make a selection from ids or from another selection.

        Args:
            questions: A selection, the ids of questions, or None for all questions.
            limit: Maximum number of questions. It replaces the selection's own limit. None keeps the selection's limit.

        Returns:
            The selection.

        Raises:
            InputError: If `questions` is an empty collection of ids.
        """
        if not isinstance(questions, QuestionSelection):
            ids = None if questions is None else tuple(dict.fromkeys(questions))
            if ids == ():
                raise InputError("no question is named", field="questions")
            questions = cls(questions=ids or ())
        return questions if limit is None else replace(questions, limit=limit)

    def record(self) -> dict[str, Any]:
        """Return the options that differ from their defaults, as plain JSON.

        The result is empty if all questions are selected.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        given = {name: value for name, value in values.items() if value not in (None, ())}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in given.items()}


@dataclass(frozen=True, kw_only=True)
class MethodOptions(Options):
    """Options that change how a method answers."""

    advice: Literal["on", "off"] = option(
        "on",
        "Whether the world model of the method agent proposes the next looks. With 'off', the run is named "
        "agent-advice-off-MODEL unless --run-id is given.",
        choices=("on", "off"),
    )
    looks: int | None = option(
        None,
        "For react, agent, agent-no-world and random-looks: maximum number of looks per question (default: 24). The "
        "run is named METHOD-looks-N-MODEL unless --run-id is given.",
        minimum=1,
        maximum=48,
        metavar="N",
    )
    history: int | None = option(
        None,
        "For react and agent-no-world: send only the last N pictures in each turn, and the frame and angle of each "
        "older picture. Default: send all pictures.",
        minimum=1,
        metavar="N",
    )
    prompts: PromptSet = option(
        "default",
        "For methods other than the agents: the set of prompts. 'paper' follows the paper's prompts in other words. "
        "Its runs are named METHOD-paper-MODEL unless --run-id is given. docs/methods.md lists the differences.",
        choices=get_args(PromptSet),
    )
    opaque: bool = option(
        False,
        "Replace names of sequences and ids of questions by hashes in all that the method sees. The hashes are equal "
        "in all runs of a store.",
    )
    simulate: tuple[str, ...] = option(
        (),
        "Change one setting of the simulated model, such as box=0.1 or seed=3. docs/models.md lists the settings. May "
        "be repeated.",
        metavar="KEY=VALUE",
    )


@dataclass(frozen=True, kw_only=True)
class RunOptions(Options):
    """Options of the run itself, such as its id, its files, and the questions that it answers at the same time.

    To answer the same questions several times, make several runs that differ in `epoch`: 1, 2, 3 and so on. The name of
    such a run ends in its epoch. In each epoch, the simulated model has another seed.
    """

    run_id: str | None = option(None, "Name of the run. Default: METHOD-MODEL, such as react-simulated or human-ada.")
    resume: bool = option(
        False,
        "Continue a run that was stopped. Questions that ended in an error are asked again. If more questions are "
        "selected than before, the new questions are asked too.",
    )
    concurrency: int = option(16, "Maximum number of questions answered at the same time.", minimum=1, maximum=64)
    images: Path | None = option(
        None, "Folder of the panoramas, with one folder per sequence. Default: the folder recorded in the store."
    )
    strict_preflight: bool = option(
        False, "Refuse the run if the server fails a check that the method needs. Default: only print a warning."
    )
    keep_going: bool = option(
        False, "Go on even if the first 20 finished questions have no readable reply. Default: stop the run then."
    )
    epoch: int | None = None


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """All options of `evaluate`, in one field per subject.

    Example:
        EvaluateOptions(selection=QuestionSelection(limit=20), run=RunOptions(run_id="first"))
    """

    endpoint: EndpointOptions = DEFAULT_ENDPOINT
    selection: QuestionSelection = QuestionSelection()
    method: MethodOptions = MethodOptions()
    run: RunOptions = RunOptions()


DEFAULTS: Final = EvaluateOptions()
