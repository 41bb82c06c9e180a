"""One question with everything that is stored of it: its row of `questions`, and its private row of `answers`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Self

import msgspec

from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import AnswerMode, Choice
from jrdb_avr.schema.labels import answer_of_choice

PROFILE_KEY: Final = "profile"
"""Key in the metadata of question files: the profile of a training set; absent from a benchmark."""

DISJOINT_KEY: Final = "disjoint_from"
"""Likewise of a training set: the generation of the held-out questions that it keeps away from, or empty."""


class Proof(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One proof: whether it holds (None: it is not run), how the program's answer compares, and that answer."""

    kind: str
    variant: str
    holds: bool | None
    outcome: str
    answer: str | None = None


class NeededBox(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A box that whoever answers must see; the decisive ones do not all lie in the view straight ahead."""

    node: str
    track: int
    frame: int
    x: float
    y: float
    w: float
    h: float
    decisive: bool


class QuestionRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A question: the columns of `questions`, then those of `answers`, whose JSON texts are read."""

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
    def read(cls, row: Mapping[str, Any], own: Mapping[str, Any]) -> Self:
        """The record of a row of `questions` and its row of `answers`. Raises msgspec.MsgspecError for a bad text."""
        texts = {}
        for name in _JSON_COLUMNS:
            try:
                texts[name] = msgspec.json.decode(own[name])
            except msgspec.DecodeError as error:
                raise msgspec.DecodeError(f"{name}: {error}") from None
        return msgspec.convert({**own, **row, **texts}, cls)

    def columns(self) -> dict[str, Any]:
        """The columns of both tables."""
        texts = {name: msgspec.json.encode(getattr(self, name)).decode() for name in _JSON_COLUMNS}
        return msgspec.structs.asdict(self) | texts

    @property
    def answer_text(self) -> str:
        """What the true choice says, empty where there is no such choice, or the answer's JSON."""
        answer = decode_answer(self.answer_mode, self.answer)
        if not isinstance(answer, Choice):
            return self.answer
        return answer_of_choice(self.choices[answer.choice - 1]) if answer.choice <= len(self.choices) else ""


_JSON_COLUMNS: Final = ("proofs", "distractors", "bindings", "needed")
