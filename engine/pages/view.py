"""The pages of the command `view`: an overview of runs and questions, one question, and a comparison of two runs.

If scores are not shown, only public files are read. The pages then have no true answer, no box of the target, and no
outcome of a run.
"""

from __future__ import annotations

import urllib.parse
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Final

from jrdb_avr.engine.local_server import Request, Response
from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.page import readable, render
from jrdb_avr.engine.pages.report import report_page
from jrdb_avr.engine.pages.trace import trace_page
from jrdb_avr.engine.pages.view_question import question_page
from jrdb_avr.engine.report.comparison import Comparison
from jrdb_avr.engine.report.run_scores import predictions_path
from jrdb_avr.engine.report.scored_runs import SCORES, distinguishing_settings
from jrdb_avr.engine.report.time_grounding import find_pairs
from jrdb_avr.engine.report.traces import StoredRow, Trace, Transcript, read_rows
from jrdb_avr.queries.questions import QuestionRow, read_question_rows, read_sequences
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest, run_ids
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.errors import InputError, StoreError

SCORE_OUTCOMES: Final = ("both right", "answer only", "box only", "both wrong")
"""Possible outcomes of a question that a run has answered, if scores are shown."""

_PER_PAGE: Final = 100
_PUBLIC: Final = ("family", "template", "sequence")
_PRIVATE: Final = ("outcome", "cause")


@dataclass(frozen=True)
class ViewedRun:
    """A run as the pages show it.

    Attributes:
        manifest: The run's manifest.
        predictions: For each question id, the row of the table `predictions`.
        scores: By question id, the scores answer, evidence and combined, each 0 or 1. Empty if scores are not shown.
        causes: By question id, the reason why the evidence score is 0. Questions with the evidence score 1 are missing.
            Empty if scores are not shown.
    """

    manifest: RunManifest
    predictions: Mapping[str, StoredRow]
    scores: Mapping[str, Sequence[int]]
    causes: Mapping[str, str]

    @property
    def name(self) -> str:
        """The run's id."""
        return self.manifest.run_id

    def outcome(self, question_id: str) -> str:
        """Return the run's outcome for a question, one of `SCORE_OUTCOMES`, or "" if the question has no score."""
        if question_id not in self.scores:
            return ""
        answer, evidence, _ = self.scores[question_id]
        return SCORE_OUTCOMES[2 * (not answer) + (not evidence)]

    def mean(self, column: str) -> float | None:
        """Return the mean of a column of `predictions`, or None if there are no predictions. A null counts as 0."""
        values = [row[column] or 0 for row in self.predictions.values()]
        return sum(values) / len(values) if values else None

    def count(self, status: str) -> int:
        """Return the number of predictions that have the given status."""
        return sum(row["status"] == status for row in self.predictions.values())

    def share(self, score: int) -> float | None:
        """Return the mean of a score in percent, or None if there are no scores. `score` is the index in `SCORES`."""
        return 100 * sum(scores[score] for scores in self.scores.values()) / len(self.scores) if self.scores else None


class Viewer:
    """Server of the pages of `view`. If `comparison` is None, the pages show no scores and no true answers."""

    def __init__(self, store: Store, image_root: str | None, comparison: Comparison | None) -> None:
        """Read the questions and the finished runs of a store.

        Raises:
            StoreError: If a public file is missing.
        """
        self.store, self.comparison = store, comparison
        self.questions = read_question_rows(store)
        self.sequences = read_sequences(store)
        self.pictured = image_root is not None
        self._observer = Observer(image_root, self.sequences.values())
        self._by_id = {question.question_id: question for question in self.questions}
        runs = scored_runs(comparison) if comparison is not None else public_runs(store)
        self.runs = {run.name: run for run in runs}
        self._twins = {} if comparison is None else self._find_twins()
        self._pages: dict[str, Callable[[Request], Response]] = {
            "": self._overview,
            "question": self._question,
            "compare": self._compare,
            "panorama": self._panorama,
        }
        if comparison is not None:
            self._pages |= {"report": self._report, "trace": self._trace}

    def respond(self, request: Request) -> Response:
        """Respond to a request.

        Args:
            request: The request.

        Returns:
            A page as HTML, or a picture as JPEG.

        Raises:
            AvrError: If the page, run, question or frame is unknown.
        """
        if request.method != "GET" or request.path not in self._pages:
            raise InputError("there is no such page", field="path")
        return self._pages[request.path](request)

    def _html(self, name: str, **values: Any) -> Response:
        return Response(render(name, viewer=self, at=address, **values).encode("utf-8", "replace"))

    # -- pages --------------------------------------------------------------------------------------------------------

    def _overview(self, request: Request) -> Response:
        chosen = [self.runs[name] for name in dict.fromkeys(request.query.get("run", ())) if name in self.runs]
        runs = chosen or list(self.runs.values())
        names = _PUBLIC if self.comparison is None else _PUBLIC + _PRIVATE
        filters = {name: value for name in names if (value := request.value(name))}
        matching = [question for question in self.questions if _fits(question, filters, runs)]
        last = max(0, (len(matching) - 1) // _PER_PAGE)
        page = min(int(text) if (text := request.value("page")).isdecimal() and len(text) < 7 else 0, last)
        options = {name: sorted({str(getattr(question, name)) for question in self.questions}) for name in _PUBLIC}
        if self.comparison is not None:
            options["outcome"] = list(SCORE_OUTCOMES)
            options["cause"] = sorted({cause for run in self.runs.values() for cause in run.causes.values()})
        return self._html(
            "view.html",
            runs=runs,
            apart={} if self.comparison is None else distinguishing_settings(self.comparison.runs),
            options=options,
            selected=filters,
            matching=len(matching),
            questions=matching[page * _PER_PAGE : (page + 1) * _PER_PAGE],
            page=page,
            last=last,
            parameters=[("run", run.name) for run in chosen] + list(filters.items()),
            kinds=SCORES,
        )

    def _question(self, request: Request) -> Response:
        question = self._find_question(request.value("id"))
        having = [run for run in self.runs.values() if question.question_id in run.manifest.question_ids]
        run_id = request.value("run")
        chosen = next((run for run in having if run.name == run_id), having[0] if having and not run_id else None)
        transcript: Transcript | None = None
        missing = "" if chosen or not run_id else f"run {run_id[:80]} does not have this question"
        if chosen is not None:
            read = Transcript if self.comparison is None else Trace
            try:
                transcript = read(self.store, chosen.name, question.question_id)
            except (StoreError, InputError) as error:
                missing = str(error)
        index = self.questions.index(question)
        near = [self.questions[at] if 0 <= at < len(self.questions) else None for at in (index - 1, index + 1)]
        truth = None
        if self.comparison is not None:
            (truth,) = read_rows(self.store.question_path("answers"), "question_id", question.question_id).to_pylist()
        shown = {"runs": having, "missing": missing, "near": near, "pictured": self.pictured, "at": address}
        info, twin = self.sequences[question.sequence], self._twins.get(question.question_id)
        page = question_page(question, info, chosen, transcript, twin, truth, **shown)
        return Response(page.encode("utf-8", "replace"))

    def _compare(self, request: Request) -> Response:
        names = [request.value(name) for name in ("first", "second")]
        if unknown := [name for name in names if name not in self.runs]:
            raise InputError(f"no run {unknown[0][:80]!r}", field="run")
        first, second = (self.runs[name] for name in names)
        score = request.value("score") if request.value("score") in SCORES else "combined"
        both = set(first.manifest.question_ids) & set(second.manifest.question_ids)
        shared = [question for question in self.questions if question.question_id in both]
        titles: dict[Any, str] = {False: "different answers", True: "the same answer"}
        keys: list[Any] = [self.answer_of(first, question) == self.answer_of(second, question) for question in shared]
        if self.comparison is not None:
            titles = {(1, 0): "only the first", (0, 1): "only the second", (1, 1): "both", (0, 0): "neither"}
            column, names = SCORES.index(score), [question.question_id for question in shared]
            keys = [(first.scores[name][column], second.scores[name][column]) for name in names]
        pairs = list(zip(keys, shared, strict=True))
        groups = {title: [question for key, question in pairs if key == kind] for kind, title in titles.items()}
        return self._html(
            "view_compare.html", first=first, second=second, groups=groups, n=len(shared), kinds=SCORES, score=score
        )

    def _report(self, request: Request) -> Response:
        assert self.comparison is not None, "a page with scores"
        return Response(report_page(self.comparison, links=address).encode("utf-8", "replace"))

    def _trace(self, request: Request) -> Response:
        trace = Trace(self.store, request.value("run"), self._find_question(request.value("id")).question_id)
        return Response(trace_page(trace, self._observer).encode("utf-8", "replace"))

    def _panorama(self, request: Request) -> Response:
        frame = request.value("frame")
        if not (frame.isascii() and frame.isdecimal() and len(frame) < 8):
            raise InputError("a frame is a number", field="frame")
        picture = self._observer.stored(request.value("sequence"), int(frame))
        return Response(picture.jpeg, "image/jpeg", lasting=True)

    def _find_question(self, question_id: str) -> QuestionRow:
        if question_id not in self._by_id:
            raise InputError(f"no question {question_id[:40]!r}", field="question_id")
        return self._by_id[question_id]

    def _find_twins(self) -> dict[str, tuple[QuestionRow, str, str]]:
        """Return, by question id, the time twin of each question that has one, and the true answers as JSON.

        The twin's answer comes first, then the question's.
        """
        answers = self.store.questions("answers", ["question_id", "answer", "twin_id"])
        rows, pairs = answers.to_pylist(), find_pairs(answers["twin_id"].to_pylist()).tolist()
        return {
            first["question_id"]: (self._by_id[second["question_id"]], second["answer"], first["answer"])
            for pair in pairs
            for first, second in permutations((rows[position] for position in pair), 2)
        }

    def answer_of(self, run: ViewedRun, question: QuestionRow) -> str:
        """Return a run's answer to a question in words, or an empty text if there is no answer."""
        row = run.predictions.get(question.question_id)
        fps = self.sequences[question.sequence].fps
        return "" if row is None else readable(question.answer_mode, row["answer"], question.choices, fps)


def address(page: str, /, *pairs: tuple[str, str], **values: str) -> str:
    """Return the relative address of a page.

    Args:
        page: Name of the page. An empty name is the overview.
        *pairs: Parameters as name and value. A name may occur several times.
        **values: Parameters by name.

    Returns:
        The address.
    """
    return f"{page or './'}?{urllib.parse.urlencode([*pairs, *values.items()], errors='replace')}"


def public_runs(store: Store) -> list[ViewedRun]:
    """Read the finished runs of a store from public files only.

    Args:
        store: The store.

    Returns:
        The runs, without scores. A run is left out if the questions of the store have changed since the run.
    """
    runs = []
    for name in run_ids(store):
        try:
            manifest = read_run_manifest(store, name)
            predictions = read_table(predictions_path(store, name))
        except StoreError:
            continue
        if manifest.questions_sha256 == questions_hash(store):
            runs.append(ViewedRun(manifest, _by_question(predictions.to_pylist()), {}, {}))
    return runs


def scored_runs(comparison: Comparison) -> list[ViewedRun]:
    """Convert the scored runs of a comparison to `ViewedRun` objects.

    Args:
        comparison: The comparison.

    Returns:
        The runs with their scores, in the order of the comparison.
    """
    causes, columns = comparison.causes(), [f"{name}_score" for name in SCORES]
    scores: dict[str, dict[str, list[int]]] = {}
    for row in comparison.scores.to_pylist():
        scores.setdefault(row["run_id"], {})[row["question_id"]] = [row[column] for column in columns]
    return [
        ViewedRun(
            read_run_manifest(comparison.store, run.manifest.run_id),
            _by_question(read_table(predictions_path(comparison.store, run.manifest.run_id)).to_pylist()),
            scores.get(run.manifest.run_id, {}),
            {question: cause for (name, question), cause in causes.items() if name == run.manifest.run_id},
        )
        for run in comparison.runs
    ]


def _by_question(rows: Iterable[StoredRow]) -> dict[str, StoredRow]:
    return {row["question_id"]: row for row in rows}


def _fits(question: QuestionRow, filters: Mapping[str, str], runs: Sequence[ViewedRun]) -> bool:
    """Return whether a question matches all filters.

    The filters of the outcome and of the cause are about runs. If one of them is given, at least one run must match
    this filter. If both are given, at least one run must match both.
    """
    if any(getattr(question, name) != filters[name] for name in _PUBLIC if name in filters):
        return False
    private = {name: filters[name] for name in _PRIVATE if name in filters}
    name = question.question_id
    return not private or any(
        private.items() <= {"outcome": run.outcome(name), "cause": run.causes.get(name, "")}.items() for run in runs
    )
