"""The question templates as data: what each needs, which queries find and test it, and how its plan is formed.

A template's candidates come from `queries/generators/<name>.cypher`; each row names the description (`name`), the
moments it speaks of (`at0`, `at1`, ...) or the `segment`, and says which set-wise proofs hold. Its time proofs come
from `queries/necessity/<name>_shift.cypher` and `<name>_drop.cypher`. Adding a template is adding a row here, its
queries and its words in `schema.wording`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Final, Literal

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.plan import Condition, canonical
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.wording import TEMPLATES as WORDS
from jrdb_avr.schema.wording import Slots

TimeProof = Literal["moved", "construction"]
"""`moved`: the asked times are shifted and dropped. `construction`: the answer is the time itself."""


@dataclass(frozen=True)
class Template:
    """A kind of question about one person described at t0.

    layers: what the sequence must have. pose_answer: the answer is a pose, so that none may be stated.
    read: where the answer is read, as columns of the candidates' frames (see `candidates.FRAMES`).
    decisive: the frames whose boxes decide; where the person is absent at all of them, the box at t0 does.
    answer: the stored answer's JSON with frame columns in braces, or None where it is a text of `choices`.
    """

    name: str
    layers: tuple[str, ...]
    time_proof: TimeProof
    read: tuple[str, ...]
    decisive: tuple[str, ...]
    answer: tuple[str, ...] | None
    pose_answer: bool = False

    @property
    def family(self) -> str:
        return WORDS[self.name].family

    @property
    def times(self) -> tuple[str, ...]:
        """Names of the stated times."""
        return WORDS[self.name].times


TEMPLATES: Final = (
    Template(
        "start",
        ("2d", "actions"),
        "construction",
        read=("start",),
        decisive=("first",),
        answer=('{"frame":', "start", "}"),
    ),
    Template(
        "span",
        ("2d", "actions"),
        "construction",
        read=("start", "end"),
        decisive=("first", "last"),
        answer=('{"start_frame":', "start", ',"end_frame":', "end", "}"),
    ),
    Template("change", ("2d", "actions"), "moved", read=("t1",), decisive=("t1",), answer=None, pose_answer=True),
    Template("presence", ("2d",), "moved", read=("t1", "t2"), decisive=("t1", "t2"), answer=None),
    Template("distance", ("2d", "3d"), "moved", read=("t0", "t1"), decisive=("t1",), answer=None),
)


def query_text(folder: str, name: str) -> str | None:
    """The text of a packaged Cypher file, or None where there is none."""
    file = resources.files("jrdb_avr.queries").joinpath(folder, f"{name}.cypher")
    return file.read_text(encoding="utf-8") if file.is_file() else None


def query_values(rules: Rules) -> dict[str, int | float]:
    """Values of the parameters that the queries may use; frames and metres."""
    return {
        "wait": frames(rules.min_wait_s),
        "changed": rules.distance_changed_m,
        "same": rules.distance_same_m,
    }


_CONDITIONS: Final = Condition(action="?conditions", at="t0")
_FRAME_MARK: Final = 9_000_001


def plan_texts(template: Template, columns: Mapping[str, pa.Array]) -> pa.Array:
    """Canonical plans of candidates, set-wise.

    `columns` holds `conditions` (as JSON, without brackets), one column of frames per stated time, and `action` where
    the template asks for one.
    """
    words = WORDS[template.name]
    marks = {name: _FRAME_MARK + i for i, name in enumerate(template.times)}
    plan = canonical(words.build(Slots((_CONDITIONS,), marks, ("?action",)[: words.actions])))
    holes = {'{"action":"?conditions","at":"t0"}': "conditions", "?action": "action"}
    holes |= {str(mark): name for name, mark in marks.items()}
    pieces: list[pa.Array | str] = [plan]
    for mark, name in holes.items():
        split: list[pa.Array | str] = []
        for piece in pieces:
            if not isinstance(piece, str):
                split.append(piece)
                continue
            for i, text in enumerate(piece.split(mark)):
                split += [columns[name], text] if i else [text]
        pieces = split
    return joined(pieces)


def joined(pieces: list[pa.Array | str]) -> pa.Array:
    """Texts put together from columns and constants; numbers are written as they are."""
    parts = [pa.scalar(piece) if isinstance(piece, str) else pc.cast(piece, pa.string()) for piece in pieces]
    return pc.binary_join_element_wise(*parts, "")
