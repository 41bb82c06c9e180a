"""The questions of a store as an OpenEnv server: `python serve_openenv.py STORE [PORT]`; it needs `openenv`.

A move is a turn of ReAct: {"action": "observe", "frame_id": ..., "angle_deg": ...} or {"action": "answer", ...}.
"""

import base64
import random
import sys
import uuid
from typing import Any, Literal

import uvicorn
from openenv.core.env_server import Action, Environment, Observation, State, create_app

import jrdb_avr as avr
from jrdb_avr.agent.model.messages import metadata_line, picture_of


class Move(Action):
    """A look or the answer."""

    action: Literal["observe", "answer"]
    frame_id: Any = None
    angle_deg: Any = None
    answer: Any = None
    evidence_bboxes: Any = None


class Shown(Observation):
    """A text, and after a look the picture: a JPEG file as base64."""

    text: str
    jpeg: str = ""


class QuestionServer(Environment):
    """One session: an episode at a time. The judge is another process, so that this one never reads the answers."""

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self, bench, judge):
        super().__init__()
        self._bench, self._judge, self._episode, self._id = bench, judge, None, None

    def reset(self, seed=None, episode_id=None, question_id=None, **_):
        question_id = question_id or random.Random(seed).choice(self._bench.questions).question_id  # noqa: S311
        self._episode, self._id = self._bench.episode(question_id), episode_id or uuid.uuid4().hex
        return Shown(text=f"{self._episode.rules('react_turns')}\n\n{self._episode.text}")

    def step(self, action, timeout_s=None, **_):
        if self._episode is None:
            return Shown(text="refused: reset first")
        episode, jpeg, running = self._episode, "", not self._episode.over
        try:
            seen = episode.move(action.model_dump(exclude_unset=True, exclude={"metadata"}))
            text = "taken" if seen is None else metadata_line(seen)
            jpeg = "" if seen is None else base64.b64encode(picture_of(seen).data).decode()
        except avr.AvrError as error:
            text = f"refused: {error}"
        reward = 0.0
        if running and episode.over:
            reward = float(self._judge.score(episode.question, episode.finished()).combined)
        left = f"Looks left: {episode.left.looks}, turns left: {episode.left.moves}"
        return Shown(text=f"{text}\n{left}", jpeg=jpeg, reward=reward, done=episode.over)

    @property
    def state(self):
        return State(episode_id=self._id, step_count=len(self._episode.turns) if self._episode else 0)


def application(store, sessions=8):
    """Return the web application. All sessions share the pictures and the judge."""
    bench, judge = avr.Bench.open(store), avr.Judge.open(store)
    return create_app(lambda: QuestionServer(bench, judge), Move, Shown, "jrdb_avr", max_concurrent_envs=sessions)


if __name__ == "__main__":
    uvicorn.run(application(sys.argv[1]), host="127.0.0.1", port=int((sys.argv[2:] or ["8736"])[0]))
