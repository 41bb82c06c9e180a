"""Let a person answer questions on the page `play`.

The page sends each move as a request, and the episode of the question carries out the move.

The person sees what the method ReAct sees: the question, the frames that may be looked at, and a crop for each look.
The person has the same rules and the same budget as ReAct. Only public files of the store are read. No response says
whether an answer is right.
"""

from __future__ import annotations

import dataclasses
import threading
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.messages import metadata_of, picture_of
from jrdb_avr.agent.model.prompts import mode_text
from jrdb_avr.engine.local_server import Request, Response
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.journal import unanswered
from jrdb_avr.engine.run.playing import Play
from jrdb_avr.engine.run.run import Run
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.errors import AvrError, InputError
from jrdb_avr.schema.method import Observation


class _Move(msgspec.Struct, forbid_unknown_fields=True):
    """A move that the page sends, and the id of the question that the move is for.

    The id shows whether this question has ended before the move arrived.
    """

    question_id: str
    move: dict[str, Any]


_MOVE: Final = msgspec.json.Decoder(_Move)


class HumanDesk:
    """Handler of the requests that one person's page sends.

    The person answers the questions of a run one after another.
    """

    def __init__(self, bench: Bench, run: Run, page: str) -> None:
        self._bench, self._run, self._page = bench, run, page
        self._due = [question.question_id for question in unanswered(bench.questions, run.finished)]
        self._play: Play | None = None
        self._observations: list[Observation] = []
        self._lock = threading.Lock()

    def respond(self, request: Request) -> Response:
        """Respond to a request of the page.

        Args:
            request: The request.

        Returns:
            The page as HTML, the state of the question as JSON, or a picture as JPEG.

        Raises:
            AvrError: If the request is unknown, or if the request cannot be carried out.
        """
        with self._lock:
            match request.method, request.path:
                case "GET", "":
                    return Response(self._page.encode())
                case "GET", "look":
                    return self._look(request.value("question"), request.value("number"))
                case "POST", "state":
                    return self._state()
                case "POST", "next":
                    self._record()
                    if self._play is not None and self._play.episode.over:
                        self._play = None
                    return self._state()
                case "POST", "move":
                    return self._move(request.body)
        raise InputError("there is no such page", field="path")

    def _move(self, body: bytes) -> Response:
        try:
            sent = _MOVE.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            raise InputError("a move is a JSON object with question_id and move", field="move") from None
        play = self._play
        if play is None or play.episode.over or play.question_id != sent.question_id:
            return self._state("this question is not being played any more")
        error = ""
        try:
            observation = play.episode.move(sent.move)
            if observation is not None:
                self._observations.append(observation)
        except AvrError as refused:
            error = str(refused)
        self._record()
        return self._state(error)

    def _record(self) -> None:
        """Append the current question to the run if the question has ended. Raise StoreError if writing fails."""
        play = self._play
        if play is not None and play.episode.over and play.question_id in self._due:
            play.record(self._run)
            self._due.remove(play.question_id)

    def _state(self, error: str = "") -> Response:
        """Begin the next question if no question is in progress, and return the content of the page as JSON."""
        if self._play is None and self._due:
            self._play, self._observations = Play.begin(self._bench, self._due[0]), []
        state: dict[str, Any] = {"due": len(self._due), "questions": len(self._bench.questions), "error": error}
        if self._play is not None:
            episode = self._play.episode
            question, info = episode.question, episode.attempt.task.sequence
            text = mode_text(episode.attempt.task)
            state["play"] = {
                "question_id": question.question_id,
                "question": question.question,
                "choices": question.choices,
                "fields": [dataclasses.asdict(part) for part in MODES[question.answer_mode].parts],
                "rule": text.rule,
                "advice": text.advice,
                "frames": info.frames,
                "fps": info.fps,
                "frame_count": info.frame_count,
                "looks": [metadata_of(observation) for observation in self._observations],
                "left": episode.left._asdict(),
                "over": episode.over,
                "answered": episode.answered and not episode.error,
            }
        return Response(msgspec.json.encode(state), "application/json")

    def _look(self, question_id: str, text: str) -> Response:
        index = int(text) if text.isascii() and text.isdecimal() and len(text) < 5 else len(self._observations)
        if self._play is None or self._play.question_id != question_id or index >= len(self._observations):
            raise InputError("there is no such look", field="number")
        return Response(picture_of(self._observations[index]).data, "image/jpeg", lasting=True)
