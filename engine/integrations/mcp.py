"""Server of questions for any agent that speaks MCP. Its tools are `next_question`, `observe` and `submit_answer`.

The moves of the agent are recorded as a run of the store. The server has no sessions. Instead, each look and
each answer carries the opaque token of its question. Only the public files of the store are read. The tools return a
question's text, its legal frames, crops with their frame and angle, and the reasons for refused moves. This module
needs the extra `mcp`.
"""

from __future__ import annotations

import contextlib
import re
import secrets
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, Required, TypedDict

import uvicorn
from mcp.server.mcpserver import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.mcpserver.tools import Tool
from mcp.server.mcpserver.utilities.types import Image
from mcp.server.transport_security import TransportSecuritySettings
from mcp.types import ToolAnnotations
from pydantic import Field, WithJsonSchema

from jrdb_avr import __version__
from jrdb_avr.agent.methods.episode import LOOK, SUBMIT, Episode
from jrdb_avr.agent.model.messages import picture_of
from jrdb_avr.agent.model.schemas import FRAME_ID_SCHEMA, evidence_schema
from jrdb_avr.engine.integrations import tool_calls
from jrdb_avr.engine.local_server import hosts_of, listen, new_token, same_token
from jrdb_avr.engine.run.bench import Bench, find_images
from jrdb_avr.engine.run.journal import unanswered
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.playing import Play, played_run
from jrdb_avr.engine.run.run import Run
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, InputError
from jrdb_avr.schema.method import Question
from jrdb_avr.schema.tables import PRIVATE

METHOD: Final = "mcp"
"""Name of the method in runs of this server. Such a run has the agent's name as the name of its model."""

MOST_OPEN: Final = 64
"""Maximum number of questions that the agent has begun but not finished."""

_HOW: Final = (
    "Answer questions about a video. Call next_question for a question, observe to look at the video, and "
    "submit_answer with your answer and the box that proves it; then next_question again, until none is left."
)

# These types only document arguments. They accept any value and none, so that the episode can count and explain faults.
_MISSING: Any = Field(default_factory=lambda: None)
_Token = Annotated[str, Field(default_factory=str)]
_FrameId = Annotated[Any, _MISSING, WithJsonSchema(FRAME_ID_SCHEMA)]
_Angle = Annotated[Any, _MISSING, WithJsonSchema({"type": "number"})]
_Answer = Annotated[Any, _MISSING, WithJsonSchema({"description": "as the question's answer_schema has it"})]
_Boxes = Annotated[Any, _MISSING, WithJsonSchema(evidence_schema())]
_HINTS: Final = ToolAnnotations(
    read_only_hint=False, destructive_hint=False, idempotent_hint=False, open_world_hint=False
)


class Begun(TypedDict, total=False):
    """Result of `next_question`. If `done` is true, it has only `message`, otherwise it has all other keys."""

    done: Required[bool]
    message: str
    episode: str
    prompt: str
    answer_schema: dict[str, Any]


class _Open(NamedTuple):
    """A question that the agent has begun. The lock lets only one call at a time make a move."""

    play: Play
    lock: threading.Lock


class Desk:
    """The MCP tools and their state: the questions that wait, and the questions that the agent has begun."""

    def __init__(self, bench: Bench, run: Run) -> None:
        self._bench, self._run = bench, run
        due = unanswered(bench.questions, run.finished)
        self._due = one_of_twins(due)[::-1]
        held_back = len(due) - len(self._due)
        wait = f"; {held_back} questions wait for another session (--resume)" if held_back else ""
        self._end = f"no question is left{wait}"
        self._open: dict[str, _Open] = {}
        self._lock = threading.Lock()

    def server(self) -> MCPServer:
        """Return an MCP server with the tools of this desk."""
        tools = [
            Tool.from_function(self.next_question, annotations=_HINTS),
            # The output is not structured, because MCP has no structured form for a list that has a picture.
            Tool.from_function(self.observe, description=LOOK, annotations=_HINTS, structured_output=False),
            Tool.from_function(self.submit_answer, description=SUBMIT, annotations=_HINTS),
        ]
        for tool in tools:
            tool.parameters["required"] = list(tool.parameters["properties"])
        return MCPServer("jrdb-avr", instructions=_HOW, version=__version__, tools=tools, log_level="WARNING")

    def next_question(self) -> Begun:
        """Begin the next question: its text with the rules, the schema of its answer, and the token of its episode."""
        with self._lock:
            if len(self._open) >= MOST_OPEN:
                raise ToolError(f"{MOST_OPEN} questions are begun and not finished: finish one of them first")
            if not self._due:
                return {"done": True, "message": self._end}
            try:
                # A question that cannot begin stays the next one.
                play = Play.begin(self._bench, self._due[-1])
            except AvrError as error:
                raise ToolError(f"the next question cannot begin: {error}") from None
            self._due.pop()
            episode, token = play.episode, secrets.token_urlsafe(12)
            self._open[token] = _Open(play, threading.Lock())
        schema = episode.answer_schema["properties"]["answer"]
        return {"done": False, "episode": token, "prompt": episode.prompt, "answer_schema": schema}

    def observe(self, episode: _Token, frame_id: _FrameId, angle_deg: _Angle) -> list[Any]:
        """Observe a frame; returns two lines (frame and angle; looks and turns left) and the picture as JPEG."""
        with self._playing(episode) as moves:
            text, seen = tool_calls.observe(moves, frame_id=frame_id, angle_deg=angle_deg)
        return [text, Image(data=picture_of(seen).data, format="jpeg")]

    def submit_answer(self, episode: _Token, answer: _Answer, evidence_bboxes: _Boxes) -> str:
        """Submit the final answer; returns a line that says it was accepted."""
        with self._playing(episode) as moves:
            return (
                f"{tool_calls.submit_answer(moves, answer, evidence_bboxes)}; call next_question for another question"
            )

    @contextlib.contextmanager
    def _playing(self, token: str) -> Iterator[Episode]:
        """Yield an episode for one move, and record its prediction if the episode ends.

        Raises:
            ToolError: If the token is unknown, or if the move is refused. The message has the reason.
        """
        held = self._open.get(token)
        if held is None:
            raise ToolError("no such episode is being played: next_question begins one")
        with held.lock:
            episode = held.play.episode
            try:
                yield episode
            except AvrError as error:
                left = f"looks left: {episode.left.looks}, turns left: {episode.left.moves}"
                raise ToolError(f"refused: {error} ({'the question is over' if episode.over else left})") from None
            finally:
                if episode.over:
                    try:
                        self._finish(token, held.play)
                    except AvrError as error:
                        raise ToolError(f"the answer is not stored yet: {error}; try again") from None

    def _finish(self, token: str, play: Play) -> None:
        with self._lock:
            if token in self._open:
                # If writing fails, the question stays open, and the agent's next call tries to write it again.
                play.record(self._run)
                del self._open[token]


def one_of_twins(questions: Iterable[Question]) -> list[str]:
    """Select the questions for one session, so that no agent is asked two time twins in one conversation.

    The texts decide, because only the answers, which are private, name the twins.

    Args:
        questions: Questions in the order of asking.

    Returns:
        The ids of the questions without each question that may be the twin of a question before it. Two questions may
        be twins if they are about one sequence, offer the same choices in the same order, state the same first time,
        and differ in one later time.
    """
    times_of: dict[tuple[str, tuple[str, ...], int], list[set[int]]] = {}
    ids = []
    for question in questions:
        times = set(map(int, re.findall(r"\(frame ([0-9]+)\)", question.question)))
        before = times_of.setdefault((question.sequence, question.choices, min(times, default=0)), [])
        if not any(len(times ^ others) == 2 for others in before if question.choices):
            before.append(times)
            ids.append(question.question_id)
    return ids


# -- a server over a store --------------------------------------------------------------------------------------------


def serve(
    store: Store | str | Path,
    *,
    port: int | None = None,
    trusted: bool = False,
    model: str = "agent",
    run_id: str | None = None,
    limit: int | None = None,
    resume: bool = False,
    images: str | Path | None = None,
    opaque: bool = False,
    ready: Callable[[str, str], None] = lambda url, token: None,
) -> str:
    """Serve the questions of a store over MCP until the agent or the user stops. Then write the tables of the run.

    Args:
        store: The store, or its folder.
        port: Port of an HTTP server on 127.0.0.1. 0 takes a free port, and None uses standard input and output.
        trusted: Whether to allow standard input and output even if the agent could read answers or labels.
        model: Name of the agent.
        run_id: Id of the run. Default: an id that is made of the names of the method and the agent.
        limit: Maximum number of questions. None sets no maximum.
        resume: Whether to continue the run if it exists.
        images: The folder of panoramas. Default: the folder that the store names.
        opaque: Whether to replace the names of sequences by opaque names.
        ready: Function that is called as soon as the HTTP server listens. Its arguments are the address of the server
            and the token that requests need.

    Returns:
        The id of the run.

    Raises:
        InputError: If standard input and output are used, `trusted` is false, and the agent could read answers.
        StoreError: If the store has no questions or panoramas, or if the run exists and `resume` is false.
    """
    store = Store.of(store)
    if port is None and not trusted and (private := private_parts(store, images)):
        raise InputError(
            f"{store.path} has {private[0]}, which an agent over stdio could read: serve a store without such files, "
            "use --http for an agent that has no access to them, or add --i-trust-the-agent",
            field="store",
        )
    chosen = QuestionSelection(limit=limit)
    playing = played_run(store, METHOD, model, run_id, questions=chosen, resume=resume, images=images, opaque=opaque)
    with playing as (bench, run):
        server = Desk(bench, run).server()
        if port is None:
            server.run("stdio")
        else:
            _serve_http(server, port, ready)
    return run.run_id


def private_parts(store: Store, images: str | Path | None) -> list[str]:
    """Find the files and folders that an agent must not read.

    Args:
        store: The store.
        images: The folder of panoramas. Default: the folder that the store names.

    Returns:
        Paths of the store's files and folders, relative to the store, and paths of label folders next to the panoramas.
    """
    labels = (store.graph_path, store.path / "annotations", store.path / "intervals")
    paths = [*map(store.question_path, PRIVATE), *labels, *store.path.glob("runs/*/scores.parquet")]
    held = [str(path.relative_to(store.path)) for path in paths if path.exists()]
    if folder := find_images(store, images):
        root = Path(folder).resolve()
        # In a copy of JRDB, these folders are between the panoramas and the root, which also has the labels.
        for name in ("image_stitched", "images"):
            root = root.parent if root.name == name else root
        held += map(str, root.glob("labels*"))
    return held


def _serve_http(server: MCPServer, port: int, ready: Callable[[str, str], None]) -> None:
    token = new_token()
    with listen(port) as listener:
        hosts = hosts_of(listener)
        # Other host names and origins are refused, because web pages in the user's browser can reach the port.
        security = TransportSecuritySettings(allowed_hosts=hosts, allowed_origins=[f"http://{host}" for host in hosts])
        app = server.streamable_http_app(stateless_http=True, json_response=True, transport_security=security)
        config = uvicorn.Config(_with_token(app, token), log_level="warning", access_log=False)
        ready(f"http://{hosts[0]}/mcp", token)
        uvicorn.Server(config).run(sockets=[listener])


def _with_token(app: Any, token: str) -> Any:
    """Return an ASGI application that passes requests with the token on to `app`, and replies to others with 401."""
    expected = f"Bearer {token}".encode()

    async def checked(scope: Any, receive: Any, send: Any) -> None:
        sent = dict(scope.get("headers", ())).get(b"authorization", b"")
        if scope["type"] == "lifespan" or same_token(sent, expected):
            await app(scope, receive, send)
        elif scope["type"] == "http":
            await send({"type": "http.response.start", "status": 401, "headers": [(b"www-authenticate", b"Bearer")]})
            await send({"type": "http.response.body", "body": b"this server takes requests with its token only\n"})

    return checked
