"""Questions as a Gymnasium environment: an episode is a question, a step a look or the answer.

    import gymnasium
    env = gymnasium.make("jrdb_avr.engine.integrations.gymnasium:JRDBAVR-v0", store="store")

All numbers of an action lie in [0, 1]: `frame` among the legal frames, `angle` of 360 degrees, `box` x1 y1 x2 y2 in the
newest picture, and `numbers` by the question's mode: the choice among the choices, a frame or two of the sequence's, a
frame and an angle, or a value of at most `LARGEST`. `act` 0 looks, 1 answers. A move that is refused shows in `info`
and is spent. The reward is 0, or with `reward` the score of the prediction at the end. Needs the extra `gym`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from jrdb_avr.agent.methods.episode import BUDGET, Episode, most_moves
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.judge import Judge
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.errors import InputError, RefusedError
from jrdb_avr.schema.method import Image, Observation
from jrdb_avr.schema.panorama import CROP

LARGEST: Final = 1000
"""Seconds or people that a number of 1 stands for."""

LOOK, ANSWER = 0, 1
"""Values of `act`."""

Reward = Literal["answer", "evidence", "combined"]


def _unit(*shape: int) -> spaces.Box:
    return spaces.Box(0.0, 1.0, shape, np.float64)


class QuestionEnv(gymnasium.Env):
    """Plays questions of a store.

    Observation: `image`, the newest crop, 480 x 480 x 3 uint8 RGB, black before the first look; `look`, its frame and
    angle; `left`, shares of the looks and moves that remain. `info` holds `question_id`, `prompt`, `answer_mode`,
    `refused` (why the last move was not carried out, else ""), and at the end `prediction`.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 1}

    def __init__(
        self,
        store: str | Path,
        *,
        questions: Iterable[str] | None = None,
        limit: int | None = None,
        images: str | Path | None = None,
        opaque: bool = False,
        budget: int = BUDGET,
        reward: Reward | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Open the questions that `Bench.open` selects; `reset` draws one, or takes options={"question_id": ...}.

        `reward`: which score to give at the end; it needs the store's answers. Raises StoreError or InputError where
        something does not fit.
        """
        self.bench = Bench.open(store, questions=questions, limit=limit, images=images, opaque=opaque)
        self.budget = budget
        self.render_mode = render_mode
        self._reward = reward
        self._judge = None if reward is None else Judge.open(store)
        self.observation_space = spaces.Dict(
            {"image": spaces.Box(0, 255, (CROP, CROP, 3), np.uint8), "look": _unit(2), "left": _unit(2)}
        )
        self.action_space = spaces.Dict(
            {"act": spaces.Discrete(2), "frame": _unit(), "angle": _unit(), "numbers": _unit(2), "box": _unit(4)}
        )
        self._episode: Episode | None = None
        self._seen: Observation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin a question. Raises InputError for an unknown id."""
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(len(self.bench.questions)))
        question_id = (options or {}).get("question_id", self.bench.questions[drawn].question_id)
        self._episode = self.bench.episode(question_id, budget=self.budget)
        self._seen = None
        return self._observation(), self._info("")

    def step(self, action: dict[str, Any]) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Make a move. `terminated`: an answer was taken; `truncated`: the moves are spent."""
        episode = self._playing()
        if action not in self.action_space:
            raise InputError("the action is not in the action space", field="action")
        refused = ""
        try:
            if action["act"] == LOOK:
                frame = episode.frames[_place(action["frame"], len(episode.frames))]
                self._seen = episode.observe(frame, _angle(action["angle"]))
            else:
                frame_id = self._seen.frame_id if self._seen is not None else ""
                box = {"frame_id": frame_id, "bbox": [_place(side, 1001) for side in action["box"]]}
                episode.submit(self._answer(action["numbers"]), [box])
        except RefusedError as error:
            refused = str(error)
        info, reward = self._info(refused), 0.0
        if episode.over:
            info["prediction"] = prediction = episode.finished()
            if self._judge is not None and self._reward is not None:
                reward = float(getattr(self._judge.score(episode.question, prediction), self._reward))
        return self._observation(), reward, episode.answered, episode.over and not episode.answered, info

    def render(self) -> Image:
        """The newest picture."""
        image: Image = self._observation()["image"]
        return image

    def close(self) -> None:
        """End the judge, if there is one."""
        if self._judge is not None:
            self._judge.close()

    # -- between spaces and moves -------------------------------------------------------------------------------------

    def _playing(self) -> Episode:
        if self._episode is None:
            raise InputError("reset() begins a question, then steps play it", field="action")
        return self._episode

    def _answer(self, numbers: Any) -> object:
        """The numbers as the contract writes an answer of the question's mode."""
        episode = self._playing()
        last = self.bench.sequences[episode.question.sequence].frame_count
        mode = MODES[episode.question.answer_mode]
        if mode.is_choice:
            return 1 + _place(numbers[0], len(episode.question.choices))
        write: dict[str, Callable[[Any], object]] = {
            "frame": lambda number: f"{_place(number, last):06d}",
            "angle": _angle,
            "decimal": lambda number: f"{LARGEST * float(number):.6f}",
        }
        return {part.key: write[part.kind](number) for part, number in zip(mode.parts, numbers, strict=False)}

    def _observation(self) -> dict[str, Any]:
        episode, seen = self._playing(), self._seen
        looks, moves = episode.left
        share = np.array([looks / max(self.budget, 1), moves / most_moves(self.budget)])
        if seen is None:
            return {"image": np.zeros((CROP, CROP, 3), np.uint8), "look": np.zeros(2), "left": share}
        place = episode.frames.index(seen.frame_index) / max(len(episode.frames) - 1, 1)
        return {"image": np.array(seen.image), "look": np.array([place, seen.angle_deg / 360]), "left": share}

    def _info(self, refused: str) -> dict[str, Any]:
        episode = self._playing()
        question = episode.question
        return {
            "question_id": question.question_id,
            "prompt": episode.text,
            "answer_mode": question.answer_mode,
            "refused": refused,
        }


def _place(share: Any, count: int) -> int:
    """Which of so many places, from 0, a number in [0, 1] stands for."""
    return round(float(share) * (count - 1))


def _angle(share: Any) -> float:
    """The angle in degrees that a number in [0, 1] stands for; rounded, so that whole degrees come back."""
    return round(float(share) * 360, 9)


gymnasium.register("JRDBAVR-v0", entry_point=QuestionEnv)
