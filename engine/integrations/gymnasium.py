"""Questions as a Gymnasium environment. An episode is a question. A step is a look or the answer.

    import gymnasium
    env = gymnasium.make("jrdb_avr.engine.integrations.gymnasium:JRDBAVR-v0", store="store")

An action has five parts. `act` is 0 to look or 1 to answer. All other values are in [0, 1]. For a look, `frame` selects
one of the legal frames and `angle` a direction (1 is 360 degrees). For an answer, `box` is x1, y1, x2, y2 in the newest
picture, and the meaning of `numbers` depends on the answer mode: a choice, one or two frames of the sequence, a frame
and an angle, or a value (1 is `LARGEST`).

A refused action costs a move, and `info` has the reason. If the environment was made with the argument `reward`, which
names a score, the reward of the last step is this score of the prediction. All other rewards are 0. This module needs
the extra `gym`.
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
"""Number of seconds or people that the value 1 in `numbers` represents."""

LOOK, ANSWER = 0, 1
"""Values of `act` in an action."""

Reward = Literal["answer", "evidence", "combined"]


def _unit(*shape: int) -> spaces.Box:
    return spaces.Box(0.0, 1.0, shape, np.float64)


class QuestionEnv(gymnasium.Env):
    """Environment that plays the questions of a store.

    An observation has `image` (the newest crop, 480 x 480 x 3 uint8 RGB, black before the first look), `look` (frame
    and angle of that crop, both in [0, 1]) and `left` (the shares of looks and of moves that remain). `info` has
    `question_id`, `prompt`, `answer_mode` and `refused` (the reason if the action was refused, otherwise an empty
    text). After the last step, `info` also has `prediction`.
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
        """Open questions of a store.

        Args:
            store: The store, or its folder.
            questions: Ids of questions. None selects all questions that have panoramas.
            limit: Maximum number of questions. None sets no maximum.
            images: The folder of panoramas. Default: the folder that the store names.
            opaque: Whether to replace the names of sequences by opaque names.
            budget: Maximum number of looks per question.
            reward: Name of the score that becomes the reward of the last step. A score needs a store with answers. If
                `reward` is None, every reward is 0.
            render_mode: The render mode, as in Gymnasium.

        Raises:
            StoreError: If the store has no questions or panoramas, or if `reward` is given and the store has no
                answers.
            InputError: If an id of `questions` is unknown.
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
        self._observed: Observation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode with a question.

        Args:
            seed: Seed of the random generator that draws questions, as in Gymnasium.
            options: A dict that may have the key `question_id`. Without this key, a question is drawn at random.

        Returns:
            The first observation, and `info`.

        Raises:
            InputError: If the question id is unknown.
        """
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(len(self.bench.questions)))
        question_id = (options or {}).get("question_id", self.bench.questions[drawn].question_id)
        self._episode = self.bench.episode(question_id, budget=self.budget)
        self._observed = None
        return self._observation(), self._info("")

    def step(self, action: dict[str, Any]) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Carry out an action: a look or an answer.

        Args:
            action: An element of the action space.

        Returns:
            The observation, the reward, `terminated` (true if an answer was accepted), `truncated` (true if no moves
            are left and no answer was accepted), and `info`.

        Raises:
            InputError: If the action is not in the action space.
        """
        episode = self._playing()
        if action not in self.action_space:
            raise InputError("the action is not in the action space", field="action")
        refused = ""
        try:
            if action["act"] == LOOK:
                frame = episode.frames[_index(action["frame"], len(episode.frames))]
                self._observed = episode.observe(frame, _angle(action["angle"]))
            else:
                frame_id = f"{self._observed.frame_index:06d}" if self._observed is not None else ""
                box = {"frame_id": frame_id, "bbox": [_index(side, 1001) for side in action["box"]]}
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
        """Return the newest crop (480, 480, 3), which is black before the first look."""
        image: Image = self._observation()["image"]
        return image

    def close(self) -> None:
        """Stop the process that computes the rewards."""
        if self._judge is not None:
            self._judge.close()

    # -- between spaces and moves -------------------------------------------------------------------------------------

    def _playing(self) -> Episode:
        if self._episode is None:
            raise InputError("call reset() before the first step", field="action")
        return self._episode

    def _answer(self, numbers: Any) -> object:
        """Convert the argument `numbers` (each in [0, 1]) to an answer. The answer mode of the question decides how."""
        episode = self._playing()
        last = self.bench.sequences[episode.question.sequence].frame_count
        mode = MODES[episode.question.answer_mode]
        if mode.is_choice:
            return 1 + _index(numbers[0], len(episode.question.choices))
        write: dict[str, Callable[[Any], object]] = {
            "frame": lambda share: f"{_index(share, last):06d}",
            "angle": _angle,
            "decimal": lambda share: f"{LARGEST * float(share):.6f}",
        }
        return {part.key: write[part.kind](share) for part, share in zip(mode.parts, numbers, strict=False)}

    def _observation(self) -> dict[str, Any]:
        episode, observed = self._playing(), self._observed
        looks, moves = episode.left
        share = np.array([looks / max(self.budget, 1), moves / most_moves(self.budget)])
        if observed is None:
            return {"image": np.zeros((CROP, CROP, 3), np.uint8), "look": np.zeros(2), "left": share}
        position = episode.frames.index(observed.frame_index) / max(len(episode.frames) - 1, 1)
        return {
            "image": np.array(observed.image),
            "look": np.array([position, observed.angle_deg / 360]),
            "left": share,
        }

    def _info(self, refused: str) -> dict[str, Any]:
        episode = self._playing()
        return {
            "question_id": episode.question.question_id,
            "prompt": episode.text,
            "answer_mode": episode.question.answer_mode,
            "refused": refused,
        }


def _index(share: Any, count: int) -> int:
    """Return the index in [0, count) that a number in [0, 1] represents. Each index has an equal part of [0, 1]."""
    return min(int(float(share) * count), count - 1)


def _angle(share: Any) -> float:
    """Return the angle in degrees that a number in [0, 1] represents, rounded so that whole degrees stay whole."""
    return round(float(share) * 360, 9)


gymnasium.register("JRDBAVR-v0", entry_point=QuestionEnv)
