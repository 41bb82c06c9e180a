"""Questions as environments for `GRPOTrainer` of TRL, whose policy is a vision-language model that calls tools.

    environments = Environments("train")
    GRPOTrainer(..., train_dataset=Dataset.from_list(environments.rows()), environment_factory=environments)

A rollout is an episode. Its tools are `observe` and `submit_answer`. If a move is refused, the tool raises the reason,
which TRL gives to the model as the result of the call. The reward comes from a separate process (`Judge`), so that the
process of the policy never reads the answers. This module needs the extra `rl`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal

from PIL import Image

from jrdb_avr.agent.methods.episode import BUDGET, Episode
from jrdb_avr.engine.integrations import tool_calls
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.judge import Judge


class QuestionEnvironment:
    """Environment that plays one question at a time. Its public methods are its tools, `reset` and `get_reward`."""

    def __init__(self, begin: Callable[[str], Episode], score: Callable[[Episode], float]) -> None:
        """Hold the two functions of the environment.

        Args:
            begin: Called with the id of a question. It returns a new episode.
            score: Called with an episode. It returns the reward.
        """
        self._begin, self._score = begin, score

    def reset(self, question_id: str, **columns: Any) -> None:
        """Begin the episode of a question.

        Args:
            question_id: The id of the question.
            **columns: The other columns of the row of the data set, which are ignored.

        Raises:
            InputError: If the question id is unknown.
        """
        self._episode = self._begin(question_id)

    def get_reward(self) -> float:
        """Return the score of the episode. If no answer was accepted, the newest readable answer counts."""
        return self._score(self._episode)

    # TRL makes the schemas of the tools from these two signatures and docstrings, which the model reads.

    def observe(self, frame_id: str, angle_deg: float) -> list[dict[str, Any]]:
        """Look at a frame in a direction: a picture 46 degrees wide; 180 is ahead, 90 left, 0 behind, 270 right.

        Args:
            frame_id: One of the legal frames, as six digits.
            angle_deg: The panorama angle of the centre of the picture, in degrees.

        Returns:
            The frame and angle, the looks and turns that are left, and the picture.
        """
        text, seen = tool_calls.observe(self._episode, frame_id=frame_id, angle_deg=angle_deg)
        return [{"type": "text", "text": text}, {"type": "image", "image": Image.fromarray(seen.image)}]

    def submit_answer(self, answer: int | dict[str, Any], evidence_bboxes: list[dict[str, Any]]) -> str:
        """Give the final answer, with one box round the person in the newest picture, in thousandths of it.

        Args:
            answer: The answer, in the form that the question asks for.
            evidence_bboxes: A list of one object, with the frame_id of the newest picture and bbox: x1, y1, x2, y2.

        Returns:
            The word "taken".
        """
        return tool_calls.submit_answer(self._episode, answer, evidence_bboxes)


class Environments:
    """Factory of environments over the questions of a store. All its environments share the pictures and a judge."""

    def __init__(
        self,
        store: str | Path,
        *,
        questions: Iterable[str] | None = None,
        limit: int | None = None,
        budget: int = BUDGET,
        reward: Literal["answer", "evidence", "combined"] = "combined",
    ) -> None:
        """Open questions of a store that has answers.

        Args:
            store: The store, or its folder.
            questions: Ids of questions. None selects all questions that have panoramas.
            limit: Maximum number of questions. None sets no maximum.
            budget: Maximum number of looks per question.
            reward: Name of the score that becomes the reward. A policy can earn `answer` by guesses, and `evidence`
                by the box of any moment at which it finds the person. `combined` needs both.

        Raises:
            StoreError: If the store has no questions, panoramas or answers.
            InputError: If an id of `questions` is unknown.
        """
        self._bench = Bench.open(store, questions=questions, limit=limit)
        self._judge = Judge.open(store)
        self._budget, self._reward = budget, reward

    def __call__(self) -> QuestionEnvironment:
        """Return a new environment."""
        return QuestionEnvironment(self._begin, self._score)

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of a data set: the columns `question_id` and `prompt`, which is a list of one message."""
        ids = [question.question_id for question in self._bench.questions]
        prompts = [[{"role": "user", "content": self._begin(question_id).prompt}] for question_id in ids]
        return [{"question_id": id_, "prompt": prompt} for id_, prompt in zip(ids, prompts, strict=True)]

    def _begin(self, question_id: str) -> Episode:
        return self._bench.episode(question_id, budget=self._budget)

    def _score(self, episode: Episode) -> float:
        return float(getattr(self._judge.score(episode.question, episode.finished()), self._reward))
