"""References: guessers beside the runs in the tables of scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

_REFERENCES: Final = (
    ("pure chance", "answer", ("uniform",)),
    ("text only", "answer", ("uniform", "constant", "offset", "label", "set", "pair")),
    ("box only", "evidence", ("largest", "best_box")),
)
"""Name, score and blind guessers of each reference."""


class Reference(NamedTuple):
    """A reference with its scores.

    Attributes:
        name: Its name. It has a space, so that no run id is equal to it.
        kind: The score that it has: "answer" or "evidence".
        guessers: Names of blind guessers. The best guesser of a group of questions guesses all of the group.
        label: Text that marks its rows.
        scores: Its score, 0 to 1, by the id of each question that it can guess.
    """

    name: str
    kind: str
    guessers: tuple[str, ...]
    label: str
    scores: dict[str, float]

    def add(self, question_ids: Sequence[str], scores: Mapping[str, Sequence[float]]) -> None:
        """Take the scores of its best guesser.

        Args:
            question_ids: Ids of a group of questions.
            scores: The scores of each guesser that applies to the group, by its name.
        """
        if among := [scores[name] for name in self.guessers if name in scores]:
            self.scores.update(zip(question_ids, max(among, key=sum), strict=True))

    def row(self, question_ids: Sequence[str]) -> dict[str, Any]:
        """Average the scores of questions.

        Args:
            question_ids: Ids of the questions.

        Returns:
            The row of a table, in percent. `n` counts the questions that have a score. With none, the row has no score.
        """
        scores = [self.scores[question_id] for question_id in question_ids if question_id in self.scores]
        share = {self.kind: round(100 * sum(scores) / len(scores), 2)} if scores else {}
        return {"run": self.name, "method": "", "model": "", "label": self.label, "n": len(scores)} | share


def make_references(synthetic: bool) -> list[Reference]:
    """Make all references, without scores. `synthetic` says whether the questions are about the sample world."""
    label = "guesser, synthetic" if synthetic else "guesser"
    return [Reference(name, kind, guessers, label, {}) for name, kind, guessers in _REFERENCES]
