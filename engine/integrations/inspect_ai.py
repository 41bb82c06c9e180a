"""Questions as tasks of Inspect, the evaluation framework `inspect_ai`.

    inspect eval jrdb_avr/react -T store=STORE --model ...

    jrdb_avr/react    task: ReAct with this benchmark's prompts
    jrdb_avr/tools    task: Inspect's own agent with the tools `observe` and `submit_answer`
    jrdb_avr/method   solver: a method of this benchmark, as in `--solver jrdb_avr/method -S name=NAME -S store=STORE`
    jrdb_avr/judged   scorer: answer, evidence, combined and hallucination

The target of each sample is empty, so that solvers and logs never get the answer. The scorer sends each prediction to
a separate process (`Judge`), which returns only the scores. On a machine without answers, run `inspect eval
--no-score`. Then run `inspect score LOG --scorer jrdb_avr/judged -S store=STORE` on the machine that has the answers.
This module needs the extra `inspect`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import anyio.from_thread
import anyio.to_thread
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
from jrdb_avr.agent.model.messages import Message, Part, metadata_line, picture_of
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.model.schemas import frame_schema
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.journal import finished_entry
from jrdb_avr.engine.run.judge import Judge, QuestionScore
from jrdb_avr.engine.run.methods import METHODS, WORLD_METHODS, make_method
from jrdb_avr.schema.errors import AvrError, InputError, RefusedError, StoreError
from jrdb_avr.schema.method import Observation, Prediction, Question

PREDICTION: Final = "jrdb_avr:prediction"
"""Key of a sample's current prediction in the store that Inspect keeps for the sample.

The prediction has the form of a row of the table `predictions`.
"""

_GO_ON: Final = "Your last turn called no tool, and cost a turn. Call observe, or submit_answer."
_AT_ONCE: Final = 64
"""Maximum number of methods that run at the same time, each in its own thread."""

_SCORES: Final = ("answer", "evidence", "combined")
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
    config = GenerateConfig(temperature=0)
    return Task(MemoryDataset(samples, "jrdb_avr"), solver=player, scorer=judged(store), config=config)


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
        player = make_method(name, _InspectChat(model), convention_of(model.name))
        prediction = await anyio.to_thread.run_sync(player.answer, task, limiter=threads)
        _keep(state, task.question, prediction)
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
        observation = _move(state, episode, {"action": "observe", "frame_id": frame_id, "angle_deg": angle_deg})
        assert observation is not None, "a look that is not refused returns what it shows"
        left = f"Looks left: {episode.left.looks}, turns left: {episode.left.moves}"
        text = f"{metadata_line(observation)}\n{left}"
        return [ContentText(text=text), ContentImage(image=picture_of(observation).uri)]

    async def submit_answer(answer: Any, evidence_bboxes: Any) -> str:
        _move(state, episode, {"action": "answer", "answer": answer, "evidence_bboxes": evidence_bboxes})
        return "taken"

    look = {"frame_id": frame_schema(episode.frames), "angle_deg": {"type": "number"}}
    answer = episode.answer_schema["properties"]
    return [
        ToolDef(observe, "observe", LOOK, _parameters(look), max_output=0),
        ToolDef(submit_answer, "submit_answer", SUBMIT, _parameters(answer)),
    ]


def _parameters(properties: Mapping[str, Any]) -> ToolParams:
    described = {name: {"description": name, **schema} for name, schema in properties.items()}
    return ToolParams.model_validate({"properties": described, "required": list(properties)})


def _move(state: TaskState, episode: Episode, move: Mapping[str, Any]) -> Observation | None:
    """Make a move, and store the prediction so far, because a limit may end the sample at any time.

    Raises:
        ToolError: If the move is refused.
    """
    try:
        return episode.move(move)
    except AvrError as error:
        raise ToolError(f"refused: {error}") from None
    finally:
        _keep(state, episode.question, episode.finished())


def _keep(state: TaskState, question: Question, prediction: Prediction) -> None:
    state.store.set(PREDICTION, finished_entry(question, prediction, (), (), 0.0).prediction)


class _InspectChat:
    """A `Chat` client that sends requests through Inspect's model. The client is called from the thread of a method."""

    def __init__(self, model: Model) -> None:
        self._model = model

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        sent = [_message(message) for message in messages]
        # The schema is always forwarded, because a server decodes differently without a schema.
        form = None if schema is None else ResponseSchema(name="reply", json_schema=JSONSchema(**schema), strict=True)
        config = GenerateConfig(response_schema=form)
        output = anyio.from_thread.run(lambda: self._model.generate(sent, config=config))
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
def hallucination() -> Metric:
    """Return the metric hallucination: the share of right answers that have a wrong box, or 0 if no answer is right."""

    def compute(scores: list[SampleScore]) -> float:
        right = [sample.score.value for sample in scores if sample.score.value["answer"]]
        return sum(1 - value["combined"] for value in right) / len(right) if right else 0.0

    return compute


@scorer(
    metrics=[{name: [mean(), stderr(cluster="sequence")] for name in _SCORES}, hallucination()],
)
def judged(store: str) -> Scorer:
    """Return the scorer that scores the stored prediction of each sample by the answers of a store.

    Args:
        store: The folder of the store.

    Returns:
        The scorer. A sample that has no prediction scores 0.
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
        if row is None:
            return Score(value=dict.fromkeys(_SCORES, 0), explanation="no prediction")
        async with lock:
            scores = await anyio.to_thread.run_sync(judge, row)
        value = {name: getattr(scores, name) for name in _SCORES}
        return Score(value=value, answer=row["answer"], explanation=row["reason"] or row["status"])

    return score
