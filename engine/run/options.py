"""Options of a run, grouped by subject. `evaluate`, the command line and `runs.toml` all fill these classes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jrdb_avr.agent.model.options import DEFAULTS as DEFAULT_ENDPOINT
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.engine.run.methods import POLICIES
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.option import option

if TYPE_CHECKING:
    from jrdb_avr.agent.reference.method import Policy
    from jrdb_avr.agent.simulated.knobs import Knobs


@dataclass(frozen=True, kw_only=True)
class QuestionSelection:
    """Options that select the questions of a run. The default is all questions.

    A question must match every non-empty tuple of names. The same selection from the same store always gives the same
    list. A larger `limit` or `per_template` only adds questions to the list, so that a run can grow.
    """

    questions: tuple[str, ...] = option((), "Question ids separated by commas, or a file with one id per line.")
    families: tuple[str, ...] = option((), "Only of this family. May be repeated.", flag="family", metavar="NAME")
    templates: tuple[str, ...] = option((), "Only of this template. May be repeated.", flag="template", metavar="NAME")
    sequences: tuple[str, ...] = option((), "Only of this sequence. May be repeated.", flag="sequence", metavar="NAME")
    per_template: int | None = option(
        None,
        "Maximum questions per template. With --limit each template gets the same number, if it has enough questions.",
        minimum=1,
        metavar="N",
    )
    limit: int | None = option(
        None, "Maximum questions in total, counted among questions that have panoramas.", minimum=1, metavar="N"
    )
    seed: int | None = option(None, "Draw the questions at random; without a seed the first ones are taken.")
    shard: tuple[int, int] | None = option(
        None,
        "Answer the selected questions of every Nth sequence in the order of names, from the Ith on. The name of the "
        "run ends in -IofN; 'runs merge' joins the N runs.",
        metavar="I/N",
    )

    @classmethod
    def of(cls, questions: QuestionSelection | Iterable[str] | None, limit: int | None = None) -> QuestionSelection:
        """Make a selection from ids or from another selection.

        Args:
            questions: A selection, the ids of questions, or None for all questions.
            limit: Maximum number of questions, in place of the maximum of the selection. None keeps that maximum.

        Returns:
            The selection.

        Raises:
            InputError: If `questions` has no id.
        """
        if not isinstance(questions, QuestionSelection):
            ids = None if questions is None else tuple(dict.fromkeys(questions))
            if ids == ():
                raise InputError("no question is named", field="questions")
            questions = cls(questions=ids or ())
        return questions if limit is None else replace(questions, limit=limit)

    def record(self) -> dict[str, Any]:
        """Return the options that differ from their defaults, as plain JSON. It is empty for all questions."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        given = {name: value for name, value in values.items() if value not in (None, ())}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in given.items()}


@dataclass(frozen=True, kw_only=True)
class MethodOptions:
    """Options that shape how a method answers."""

    policy: Policy | None = option(
        None,
        "How agent and agent-no-world choose looks: 'driven' (default), by the program; 'guided', by the model among "
        "the best looks of the program; 'model', by the model alone. The first two show it one picture at a time.",
        choices=POLICIES,
    )
    history: int | None = option(
        None,
        "For react, and for agent-no-world with --policy model: send the last N pictures in each turn, and only the "
        "metadata line of older ones. By default all are sent.",
        minimum=1,
        metavar="N",
    )
    opaque: bool = option(
        False,
        "Show the method hashes in place of the names of sequences. The hashes are equal in all runs of a store.",
    )
    marker: Knobs | None = option(
        None,
        "A knob of the simulated model, on top of its profile: wrong_box=0.1, ids=off, seed=3, and others that "
        "docs/models.md lists. May be repeated.",
        metavar="KEY=VALUE",
    )


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of the run itself: its name, its files, and how it proceeds.

    Runs that answer the same questions several times differ in `epoch`, which counts from 1. The name of such a run
    ends in its epoch, and each epoch gives the simulated model another seed.
    """

    run_id: str | None = option(None, "Name of the run; by default made of method, policy (if given) and model.")
    resume: bool = option(
        False,
        "Finish a run that was stopped. Questions that ended in an error are asked again; if more questions are "
        "selected, they are asked too.",
    )
    concurrency: int = option(16, "Questions in flight at a time.", minimum=1, maximum=64)
    images: Path | None = option(
        None, "Folder with one folder of panoramas per sequence; by default the folder that the store names."
    )
    world_db: Path | None = option(
        None,
        "Graph file for the world model of the agent, in place of the graph of the store: for parallel runs, or for a "
        "store without labels.",
    )
    strict_preflight: bool = option(
        False, "Refuse the run if the server fails a check that the method needs; by default this is a warning."
    )
    epoch: int | None = None


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """All options of `evaluate`, by subject.

    Example:
        EvaluateOptions(selection=QuestionSelection(limit=20), run=RunOptions(run_id="first"))
    """

    endpoint: EndpointOptions = DEFAULT_ENDPOINT
    selection: QuestionSelection = QuestionSelection()
    method: MethodOptions = MethodOptions()
    run: RunOptions = RunOptions()


DEFAULTS: Final = EvaluateOptions()
