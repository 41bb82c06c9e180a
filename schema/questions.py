"""Questions as a store keeps them: a public row of `questions` and a private row of `answers`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Self

import msgspec

from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import AnswerMode, Choice
from jrdb_avr.schema.labels import answer_of_choice

PROFILE_KEY: Final = "profile"
"""Metadata key of a training set. Its value is the profile of `generate`. The files of a benchmark lack this key."""

DISJOINT_KEY: Final = "disjoint_from"
"""Metadata key of a training set. Its value is the generation id of the held-out questions to avoid, "" for none."""

IMPORTED_KEY: Final = "imported"
"""Metadata key of questions that another program wrote. Its value is the names of the imported files."""


class Proof(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Result of one proof of a question (docs/definitions.md, "Proofs").

    Most proofs change the plan of the question in one way, and solve the changed plan.

    Attributes:
        kind: Kind of the proof, such as `time.shift`.
        variant: Name of the change. Proofs of one kind may make different changes.
        holds: Whether the proof succeeded, or None if it was not run.
        outcome: Comparison of the changed plan's answer with the question's answer, such as "different".
        answer: Answer of the changed plan, or None if there is none.
    """

    kind: str
    variant: str
    holds: bool | None
    outcome: str
    answer: str | None = None


class NeededBox(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Box of a person that a method must see to answer the question.

    Attributes:
        node: Name of the person in the plan.
        track: Track of the person.
        frame: Frame of the box.
        x: Left edge in stitched pixels.
        y: Upper edge in stitched pixels.
        w: Width in pixels.
        h: Height in pixels.
        decisive: Whether the answer is read from this box. The view straight ahead of the robot misses at least
            one decisive box of the question.
    """

    node: str
    track: int
    frame: int
    x: float
    y: float
    w: float
    h: float
    decisive: bool


class QuestionRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Question with its answer.

    The fields are the columns of `questions`, then those of `answers`. The columns in `_JSON_COLUMNS` are decoded.
    """

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
    rules: str
    hops: int
    time_gap_s: float
    separation_deg: float
    people_in_scene: int
    bindings: dict[str, int]
    needed: tuple[NeededBox, ...]
    twin_id: str | None = None

    @classmethod
    def read(cls, row: Mapping[str, Any], private: Mapping[str, Any]) -> Self:
        """Return the record of a question.

        Args:
            row: Row of `questions`.
            private: Row of `answers` for the same question.

        Returns:
            The record.

        Raises:
            msgspec.MsgspecError: If a JSON text of the rows is malformed or has wrong types.
        """
        texts = {}
        for name in _JSON_COLUMNS:
            try:
                texts[name] = msgspec.json.decode(private[name])
            except msgspec.DecodeError as error:
                raise msgspec.DecodeError(f"{name}: {error}") from None
        return msgspec.convert({**private, **row, **texts}, cls)

    def columns(self) -> dict[str, Any]:
        """Return the values of the columns of `questions` and `answers`, by the name of the column.

        The JSON columns are encoded as text.
        """
        texts = {name: msgspec.json.encode(getattr(self, name)).decode() for name in _JSON_COLUMNS}
        return msgspec.structs.asdict(self) | texts

    @property
    def answer_text(self) -> str:
        """Text of the true choice, or the stored JSON of the answer if the answer is not a choice.

        The text is "" if the answer is a choice that does not exist.
        """
        answer = decode_answer(self.answer_mode, self.answer)
        if not isinstance(answer, Choice):
            return self.answer
        return answer_of_choice(self.choices[answer.choice - 1]) if answer.choice <= len(self.choices) else ""


_JSON_COLUMNS: Final = ("proofs", "bindings", "needed")
