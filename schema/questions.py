"""A stored question: its row of `questions` and its private row of `answers`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Self

import msgspec

from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import AnswerMode, Choice
from jrdb_avr.schema.labels import answer_of_choice

PROFILE_KEY: Final = "profile"
"""Key in the metadata of question files: the profile of a training set. A benchmark lacks the key."""

DISJOINT_KEY: Final = "disjoint_from"
"""Key in the metadata of a training set: the generation of the held-out questions that it avoids, or ""."""


class Proof(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One proof of a question.

    holds: None if the proof was not run. outcome: the program's answer compared with the stored one. answer: the
    program's answer.
    """

    kind: str
    variant: str
    holds: bool | None
    outcome: str
    answer: str | None = None


class NeededBox(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A box that a method must see to answer. At least one decisive box is outside the view straight ahead."""

    node: str
    track: int
    frame: int
    x: float
    y: float
    w: float
    h: float
    decisive: bool


class QuestionRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A question: the columns of `questions`, then the columns of `answers` with decoded JSON."""

    question_id: str
    sequence: str
    family: str
    template: str
    question: str
    choices: tuple[str, ...]
    answer_mode: AnswerMode
    answer: str
    target_track: int
    plan: str
    proofs: tuple[Proof, ...]
    distractors: tuple[str | None, ...]
    rules: str
    hops: int
    time_gap_s: float
    separation_deg: float
    people_in_scene: int
    bindings: dict[str, int]
    needed: tuple[NeededBox, ...]

    @classmethod
    def read(cls, row: Mapping[str, Any], private: Mapping[str, Any]) -> Self:
        """Return the record of a row of `questions` and its private row of `answers`.

        Raises:
            msgspec.MsgspecError: a JSON text of the row is malformed or has wrong types.
        """
        texts = {}
        for name in _JSON_COLUMNS:
            try:
                texts[name] = msgspec.json.decode(private[name])
            except msgspec.DecodeError as error:
                raise msgspec.DecodeError(f"{name}: {error}") from None
        return msgspec.convert({**private, **row, **texts}, cls)

    def columns(self) -> dict[str, Any]:
        """Return the columns of both tables by name."""
        texts = {name: msgspec.json.encode(getattr(self, name)).decode() for name in _JSON_COLUMNS}
        return msgspec.structs.asdict(self) | texts

    @property
    def answer_text(self) -> str:
        """The text of the true choice, "" if the choice does not exist; for other answer modes the answer's JSON."""
        answer = decode_answer(self.answer_mode, self.answer)
        if not isinstance(answer, Choice):
            return self.answer
        return answer_of_choice(self.choices[answer.choice - 1]) if answer.choice <= len(self.choices) else ""


_JSON_COLUMNS: Final = ("proofs", "distractors", "bindings", "needed")
