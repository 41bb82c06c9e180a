"""Questions as tasks of Inspect, the evaluation framework `inspect_ai`.

    inspect eval jrdb_avr/react -T store=STORE --model ...

    jrdb_avr/react    task: ReAct with this benchmark's prompts
    jrdb_avr/tools    task: Inspect's own agent with the tools `observe` and `submit_answer`
    jrdb_avr/method   solver: a method of this benchmark, as in `--solver jrdb_avr/method -S name=NAME -S store=STORE`
    jrdb_avr/judged   scorer: combined, answer, evidence and hallucination

The target of each sample is empty, so that solvers and logs never get the answer. The scorer sends each prediction to
a separate process (`Judge`), which returns only the scores. With `-S gold=true`, the scorer itself reads the answers,
and the log has them. On a machine without answers, run `inspect eval
--no-score`. Then run `inspect score LOG --scorer jrdb_avr/judged -S store=STORE` on the machine that has the answers.
This module needs the extra `inspect`.
"""

from __future__ import annotations

import contextlib
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any, Final

import anyio.from_thread
import anyio.to_thread
import msgspec
import pyarrow as pa
from inspect_ai import Task, task
from inspect_ai.agent import AgentState, run
from inspect_ai.agent import react as react_agent
from inspect_ai.dataset import MemoryDataset, Sample
from inspect_ai.model import (
    ChatMessage,
    ChatMessageSystem,
    ChatMessageUser,
    ContentImage,
    ContentText,
    GenerateConfig,
    Model,
    ModelOutput,
    ResponseSchema,
    get_model,
)
from inspect_ai.scorer import Metric, SampleScore, Score, Scorer, Target, mean, metric, scorer, stderr
from inspect_ai.solver import Generate, Solver, TaskState, solver
from inspect_ai.tool import Content, ToolDef, ToolError, ToolParams
from inspect_ai.util import JSONSchema

from jrdb_avr.agent.methods.episode import LOOK, SUBMIT, Episode
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.messages import Message, Part, picture_of
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.model.schemas import frame_schema
from jrdb_avr.engine.integrations import tool_calls
from jrdb_avr.engine.report.bootstrap import LEAST_CLUSTERS
from jrdb_avr.engine.report.prediction_lines import write_lines
from jrdb_avr.engine.report.scoring import box_ious, find_questions, find_target_boxes, read_boxes
from jrdb_avr.engine.report.truth import Truth, read_truth
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.journal import finished_entry
from jrdb_avr.engine.run.judge import Judge, QuestionScore
from jrdb_avr.engine.run.methods import METHODS, WORLD_METHODS, make_method
from jrdb_avr.queries.opaque import stored_ids
from jrdb_avr.queries.questions import QuestionRow, read_question_rows
from jrdb_avr.queries.runs import questions_hash
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import encode_answer
from jrdb_avr.schema.errors import AvrError, InputError, RefusedError, StoreError
from jrdb_avr.schema.method import Prediction, Question
from jrdb_avr.schema.questions import PROFILE_KEY
from jrdb_avr.schema.tables import GENERATION_KEY, RUNS

PREDICTION: Final = "jrdb_avr:prediction"
"""Key of a sample's current prediction in the store that Inspect keeps for the sample.

The prediction has the form of a row of the table `predictions`.
"""

_GO_ON: Final = "Your last turn called no tool, and cost a turn. Call observe, or submit_answer."
_AT_ONCE: Final = 64
"""Maximum number of methods that run at the same time, each in its own thread."""

_SCORES: Final = ("combined", "answer", "evidence")
_STOPPED: Final = {"max_tokens": "length", "model_length": "length", "tool_calls": "stop", "unknown": ""}
"""Finish reasons of the chat-completions format, by stop reason of Inspect. Reasons with equal names are left out."""


# -- tasks ------------------------------------------------------------------------------------------------------------


@task
def react(store: str, limit: int | None = None, images: str | None = None, opaque: bool = False) -> Task:
    """Return the Inspect task of ReAct with this benchmark's prompts.

    Args:
        store: The folder of the store.
        limit: Maximum number of questions. None sets no maximum.
        images: The folder of panoramas. Default: the folder that the store names.
        opaque: Whether to replace the names of sequences by opaque names.

    Returns:
        The task.
    """
    return _task(store, method("react", store, images, opaque), limit, images, opaque)


@task
def tools(store: str, limit: int | None = None, images: str | None = None, opaque: bool = False) -> Task:
    """Return the Inspect task of Inspect's own agent with the tools `observe` and `submit_answer`.

    Args:
        store: The folder of the store.
        limit: Maximum number of questions. None sets no maximum.
        images: The folder of panoramas. Default: the folder that the store names.
        opaque: Whether to replace the names of sequences by opaque names.

    Returns:
        The task.
    """
    return _task(store, tool_agent(store, images, opaque), limit, images, opaque)


def _task(store: str, player: Solver, limit: int | None, images: str | None, opaque: bool) -> Task:
    bench = _bench(store, images, opaque)
    samples = [_sample(bench, question) for question in bench.questions[:limit]]
    config, about = GenerateConfig(temperature=0), _about(Store(store))
    return Task(MemoryDataset(samples, "jrdb_avr"), solver=player, scorer=judged(store), config=config, metadata=about)


def _about(store: Store) -> dict[str, str]:
    """Return what a log says about the questions. `generate` records the profile of training sets only."""
    generation = (store.questions("questions", []).schema.metadata or {}).get(GENERATION_KEY.encode(), b"").decode()
    about = {"generation": generation, "questions_sha256": questions_hash(store)}
    about["profile"] = store.training_set().get(PROFILE_KEY, "benchmark")
    with contextlib.suppress(StoreError):
        about["load_rules_hash"] = store.manifest().load_rules_hash
    return about


def _sample(bench: Bench, question: Question) -> Sample:
    text = bench.episode(question.question_id).text
    public = ("sequence", "answer_mode")
    return Sample(text, id=question.question_id, metadata={name: getattr(question, name) for name in public})


@cache
def _bench(store: str, images: str | None, opaque: bool) -> Bench:
    """Return the bench of a store. All samples of the process share the bench, because it caches panoramas."""
    return Bench.open(Path(store), images=images, opaque=opaque)


# -- players ----------------------------------------------------------------------------------------------------------


@solver
def method(name: str, store: str, images: str | None = None, opaque: bool = False) -> Solver:
    """Return a method of this benchmark as an Inspect solver.

    Args:
        name: The name of a built-in method of `evaluate --method` that has no world model.
        store: The folder of the store.
        images: The folder of panoramas. Default: the folder that the store names.
        opaque: Whether to replace the names of sequences by opaque names.

    Returns:
        The solver.

    Raises:
        InputError: If the method is unknown or has a world model.
    """
    if name not in METHODS or name in WORLD_METHODS:
        names = ", ".join(method_name for method_name in METHODS if method_name not in WORLD_METHODS)
        raise InputError(f"{name!r} is not one of {names}", field="name")
    bench = _bench(store, images, opaque)
    # Methods have a separate limit, so that methods that wait for a model take no threads from Inspect's own pool.
    threads = anyio.CapacityLimiter(_AT_ONCE)

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        task, model = bench.task(str(state.sample_id)), get_model()
        chat = _InspectChat(model)
        player = make_method(name, chat, convention_of(model.name))
        prediction = await anyio.to_thread.run_sync(player.answer, task, limiter=threads)
        _keep(state, task.question, prediction)
        state.messages = chat.turns
        state.output = ModelOutput.from_content(str(model), prediction.raw)
        return state

    return solve


@solver
def tool_agent(store: str, images: str | None = None, opaque: bool = False) -> Solver:
    """Return Inspect's agent `react`, with the tools of an episode, as an Inspect solver.

    Args:
        store: The folder of the store.
        images: The folder of panoramas. Default: the folder that the store names.
        opaque: Whether to replace the names of sequences by opaque names.

    Returns:
        The solver. It ends when the episode ends.
    """
    bench = _bench(store, images, opaque)

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        episode = bench.episode(str(state.sample_id))

        async def go_on(turn: AgentState) -> bool | str:
            if turn.output.message.tool_calls or episode.over:
                return not episode.over
            with contextlib.suppress(RefusedError):
                episode.spend_malformed("the reply calls no tool")
            _keep(state, episode.question, episode.finished())
            return not episode.over and _GO_ON

        _keep(state, episode.question, episode.finished())
        agent = react_agent(prompt=None, tools=_tools(state, episode), submit=False, on_continue=go_on)
        rules = ChatMessageSystem(content=episode.rules("episode_tools"))
        played = await run(agent, [rules, *state.messages])
        state.messages, state.output = played.messages, played.output
        return state

    return solve


def _tools(state: TaskState, episode: Episode) -> list[ToolDef]:
    """Return the tools `observe` and `submit_answer` of an episode, with the schema of the question's answer."""

    async def observe(frame_id: Any, angle_deg: Any) -> list[Content]:
        with _move(state, episode):
            text, seen = tool_calls.observe(episode, frame_id=frame_id, angle_deg=angle_deg)
        return [ContentText(text=text), ContentImage(image=picture_of(seen).uri)]

    async def submit_answer(answer: Any, evidence_bboxes: Any) -> str:
        with _move(state, episode):
            return tool_calls.submit_answer(episode, answer, evidence_bboxes)

    look = {"frame_id": frame_schema(episode.frames), "angle_deg": {"type": "number"}}
    answer = episode.answer_schema["properties"]
    return [
        ToolDef(observe, "observe", LOOK, _parameters(look), max_output=0),
        ToolDef(submit_answer, "submit_answer", SUBMIT, _parameters(answer)),
    ]


def _parameters(properties: Mapping[str, Any]) -> ToolParams:
    described = {name: {"description": name, **schema} for name, schema in properties.items()}
    return ToolParams.model_validate({"properties": described, "required": list(properties)})


@contextlib.contextmanager
def _move(state: TaskState, episode: Episode) -> Iterator[None]:
    """Let a move be made, and store the prediction so far, because a limit may end the sample at any time.

    Raises:
        ToolError: If the move is refused.
    """
    try:
        yield
    except AvrError as error:
        raise ToolError(f"refused: {error}") from None
    finally:
        _keep(state, episode.question, episode.finished())


def _keep(state: TaskState, question: Question, prediction: Prediction) -> None:
    state.store.set(PREDICTION, finished_entry(question, prediction, (), (), 0.0).prediction)


class _InspectChat:
    """A `Chat` client that sends requests through Inspect's model. The client is called from the thread of a method.

    `turns` has the replies, and before each reply only those parts of its request that no earlier request has.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._sent: list[Part] = []
        self.turns: list[ChatMessage] = []

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        sent = [_message(message) for message in messages]
        # The schema is always forwarded, because a server decodes differently without a schema.
        form = None if schema is None else ResponseSchema(name="reply", json_schema=JSONSchema(**schema), strict=True)
        config = GenerateConfig(response_schema=form)
        for message in messages:
            if new := tuple(part for part in message.parts if part not in self._sent):
                self._sent += new
                self.turns.append(_message(replace(message, parts=new)))
        output = anyio.from_thread.run(lambda: self._model.generate(sent, config=config))
        self.turns.append(output.message)
        usage = output.usage
        return Reply(
            content=output.completion,
            finish_reason=_STOPPED.get(output.stop_reason, output.stop_reason),
            model=output.model,
            prompt_tokens=usage.input_tokens if usage else 0,
            completion_tokens=usage.output_tokens if usage else 0,
        )


def _message(message: Message) -> ChatMessage:
    kind = ChatMessageSystem if message.role == "system" else ChatMessageUser
    return kind(content=[_content(part) for part in message.parts])


def _content(part: Part) -> Content:
    return ContentText(text=part) if isinstance(part, str) else ContentImage(image=part.uri)


# -- scores -----------------------------------------------------------------------------------------------------------


@metric
def clustered() -> Metric:
    """Return the standard error by sequences, which needs as many sequences as an interval of `report`."""
    error = stderr(cluster="sequence")

    def compute(scores: list[SampleScore]) -> Mapping[str, float]:
        sequences = {(sample.sample_metadata or {})["sequence"] for sample in scores}
        return {"stderr": error(scores)} if len(sequences) >= LEAST_CLUSTERS else {}

    return compute


@metric
def groups() -> Metric:
    """Return the metric that computes the mean of each family and each template."""

    def compute(scores: list[SampleScore]) -> Mapping[str, float]:
        values = defaultdict(list)
        for sample in scores:
            for kind in ("family", "template"):
                values[f"{kind} {(sample.score.metadata or {})[kind]}"].append(sample.score.as_float())
        return {name: fmean(values[name]) for name in sorted(values)}

    return compute


@scorer(metrics={**{name: [mean(), clustered(), groups()] for name in _SCORES}, "hallucination": [mean()]})
def judged(store: str, gold: bool = False) -> Scorer:
    """Return the scorer that scores the stored prediction of each sample by the answers of a store.

    Args:
        store: The folder of the store.
        gold: Whether the metadata of scores has the true answer, the true box in the predicted frame, and the IoU of
            the two boxes. The log must then remain private.

    Returns:
        The scorer. A sample that has no prediction scores 0. The metric hallucination is the share of right answers
        that have a wrong box, or 0 if no answer is right.
    """
    judges: list[Judge] = []
    lock = anyio.Lock()

    def judge(row: Mapping[str, Any]) -> QuestionScore:
        for _ in range(2):
            if not judges:
                judges.append(Judge.open(store))
            try:
                return judges[0].score_row(row)
            except StoreError as error:
                # Start the judge once more, because its process may have been killed from outside.
                judges.pop().close()
                ended = error
        raise ended

    async def score(state: TaskState, target: Target) -> Score:
        row = state.store.get(PREDICTION)
        if (question := _asked(store).get(str(state.sample_id))) is None:
            raise InputError(f"{store} has no question {state.sample_id!r}: name the log's own store", field="store")
        about: dict[str, Any] = {"family": question.family, "template": question.template}
        if row is None:
            value = dict.fromkeys(_SCORES, 0.0) | {"hallucination": math.nan}
            return Score(value=value, explanation="no prediction", metadata=about)
        async with lock:
            scores = await anyio.to_thread.run_sync(judge, row)
        value = {name: getattr(scores, name) for name in _SCORES}
        # Inspect leaves NaN out of means, so that this mean is a share of the right answers.
        value["hallucination"] = 1 - scores.combined if scores.answer else math.nan
        table = pa.Table.from_pylist([{"run_id": "", **row}], RUNS["predictions"])
        line = msgspec.json.decode(next(write_lines(table)))
        about |= {name: line.get(name) for name in ("answer", "evidence", "reason")}
        about |= _gold(_truth(store), question.question_id, table) if gold else {}
        return Score(value=value, answer=row["answer"], explanation=row["reason"] or row["status"], metadata=about)

    return score


@cache
def _asked(store: str) -> dict[str, QuestionRow]:
    """Return the questions of a store by their ids and by their opaque ids."""
    rows = {row.question_id: row for row in read_question_rows(Store(store))}
    return rows | {opaque: rows[name] for opaque, name in stored_ids(Store(store)).items()}


@cache
def _truth(store: str) -> Truth:
    return read_truth(Store(store))


def _gold(truth: Truth, question_id: str, table: pa.Table) -> dict[str, Any]:
    """Return the true answer, the true box in the frame of a prediction, and the IoU of the two boxes."""
    rows, (frame, box, boxed) = find_questions(truth.ids, "", [question_id]), read_boxes(table)
    present, target = find_target_boxes(truth, rows, frame)
    return {
        "gold_answer": msgspec.json.decode(encode_answer(truth.answers[rows[0]])),
        "gold_box": target[0].tolist() if present[0] else None,
        "iou": float(box_ious(box, target)[0]) if present[0] and boxed[0] else 0.0,
    }
