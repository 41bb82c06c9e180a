"""The question templates as data: what each needs, which queries find and test it, and how its plan is formed.

A template's candidates come from `queries/generators/<name>.cypher`; each row names the description (`name`), the
moments of the people along the path (`at0` of a, then `b`, `c`, ...) with the relations between them (`r1`, ...), and
the moments (`at1`, ...) or segments it speaks of. What the perturbed programs answer comes from
`queries/necessity/*.cypher`. Adding a template is adding a row here, its queries and its words in `schema.wording`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import groupby
from typing import Final, Literal

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.answers import AnswerMode
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Event, Node, Plan, Read, Time, canonical
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.wording import FAMILIES

TimeProof = Literal["asked", "program", "construction"]
"""What time.shift and time.drop move: the asked times, with the person held; the whole program, description and hops
read anew; or nothing, as the answer is the time itself."""


@dataclass(frozen=True)
class Template:
    """A kind of question. Person a is described; `edges` lead from a to b, c, ..., the last being the target.

    layers: what the sequence must have. pose_answer: the answer is a pose, so that none may be stated.
    stated: names of the times that the question states, that of the description first; events: those found in the
    data, as (name, event, after), each bound to the frame in its place of `read`. Every start is of another action.
    form: of a template with several forms, the row of the words and the query; its forms are judged together.
    read: where the answer is read, as columns of the candidates' frames (see `candidates.Candidates`).
    decisive: the frames whose boxes of the target decide; where it is absent at all of them, the box at t0 does.
    answer: the stored answer's JSON with columns in braces, or None where it is a text of `choices`.
    shift, drop: the queries of the proofs of time; hops have those of their own.
    """

    name: str
    layers: tuple[str, ...]
    reads: tuple[AnswerMode, Read, tuple[str, ...]]
    time_proof: TimeProof
    read: tuple[str, ...]
    decisive: tuple[str, ...]
    answer: tuple[str, ...] | None = None
    stated: tuple[str, ...] = ("t0",)
    events: tuple[tuple[str, Event, str], ...] = ()
    edges: tuple[tuple[str, str], ...] = ()
    pose_answer: bool = False
    shift: str = ""
    drop: str = ""
    single_view: bool = True
    """Whether the question may be answered from one fixed view."""
    form: str = ""

    @property
    def family(self) -> str:
        return FAMILIES[self.name]

    @property
    def query(self) -> str:
        """Name of the generator."""
        return self.form or self.name

    @property
    def described(self) -> str:
        """Name of the time at which the description holds."""
        return self.stated[0]

    @property
    def counts(self) -> bool:
        """Whether people in a relation with the target are counted."""
        return self.reads[1] == "count"

    @property
    def target(self) -> str:
        return self.people[-1]

    @property
    def people(self) -> tuple[str, ...]:
        """Nodes of the plan in order."""
        return tuple(sorted({"a", *(target for _, target in self.edges)}))

    @property
    def joins(self) -> bool:
        """Whether two relations together lead to the target."""
        return len(self.edges) >= len(self.people)

    @property
    def relations(self) -> tuple[str, ...]:
        """Columns that hold the relations of the edges, or that of the people counted."""
        return tuple(f"r{i + 1}" for i in range(len(self.edges) + self.counts))

    def skeleton(self) -> Plan:
        """The plan with marks in place of conditions, relations, actions and frames."""
        times = {name: Time(frame=_FRAME_MARK + i) for i, name in enumerate(self.stated)}
        starts = 0
        for name, event, after in self.events:
            # What ends before a consequence is whatever the person did at t0.
            named = event in ("start", "end") and self.reads[1] != "next_action"
            starts += event == "start"
            action = _ACTION_MARKS[starts - 1] if named else None
            times[name] = Time(event=event, of=self.target, action=action, after=after)
        mode, read, at = self.reads
        edges = tuple(
            Edge(source=source, relation=f"?{name}", target=target, at="t0")
            for name, (source, target) in zip(self.relations, self.edges, strict=False)
        )
        return Plan(
            root="a",
            target=self.target,
            times=times,
            nodes=tuple(Node(id=node, conditions=(_CONDITIONS,) if node == "a" else ()) for node in self.people),
            edges=edges,
            answer=AnswerSpec(
                mode=mode,
                read=read,
                of=self.target,
                at=at if len(at) > 1 else at[0],
                relation="?r1" if self.counts else None,
            ),
        )


_CONDITIONS: Final = Condition(action="?conditions", at="t0")
_ACTION_MARKS: Final = ("?action", "?action2")
_FRAME_MARK: Final = 9_000_001

_START: Final[tuple[tuple[str, Event, str], ...]] = (("t1", "start", "t0"),)
_END: Final[tuple[str, Event, str]] = ("t2", "end", "t1")
_TWO_HOPS: Final = (("a", "b"), ("b", "c"))
_VALUE: Final = ('{"value":', "value", "}")

TEMPLATES: Final = (
    Template(
        "start",
        ("2d", "actions"),
        ("frame", "start", ("t1",)),
        "construction",
        read=("start",),
        decisive=("first",),
        answer=('{"frame":', "start", "}"),
        events=_START,
    ),
    Template(
        "span",
        ("2d", "actions"),
        ("span", "span", ("t1", "t2")),
        "construction",
        read=("start", "end"),
        decisive=("first", "last"),
        answer=('{"start_frame":', "start", ',"end_frame":', "end", "}"),
        events=(*_START, _END),
    ),
    Template(
        "change",
        ("2d", "actions"),
        ("multiple_choice", "action", ("t1",)),
        "asked",
        read=("t1",),
        decisive=("t1",),
        stated=("t0", "t1"),
        pose_answer=True,
        shift="pose_shift",
        drop="pose_drop",
    ),
    Template(
        "presence",
        ("2d",),
        ("multiple_choice", "presence", ("t1", "t2")),
        "asked",
        read=("t1", "t2"),
        decisive=("t1", "t2"),
        stated=("t0", "t1", "t2"),
    ),
    Template(
        "distance",
        ("2d", "3d"),
        ("multiple_choice", "distance_change", ("t0", "t1")),
        "asked",
        read=("t0", "t1"),
        decisive=("t1",),
        stated=("t0", "t1"),
        shift="distance_shift",
        drop="distance_drop",
    ),
    Template(
        "consequence",
        ("2d", "actions"),
        ("multiple_choice", "next_action", ("t1",)),
        "construction",
        read=("start",),
        decisive=("first",),
        events=(("t1", "end", "t0"),),
        pose_answer=True,
    ),
    Template(
        "two_hop",
        ("2d", "actions"),
        ("multiple_choice", "action", ("t0",)),
        "program",
        read=("t0",),
        decisive=("t0",),
        edges=_TWO_HOPS,
        pose_answer=True,
    ),
    Template(
        "three_hop",
        ("2d", "actions"),
        ("multiple_choice", "action", ("t0",)),
        "program",
        read=("t0",),
        decisive=("t0",),
        edges=(*_TWO_HOPS, ("c", "d")),
        pose_answer=True,
    ),
    Template(
        "action_search",
        ("2d", "actions"),
        ("frame_viewpoint", "start_view", ("t1",)),
        "construction",
        read=("start",),
        decisive=("first",),
        answer=('{"frame":', "start", ',"angle_deg":', "angle", "}"),
        events=_START,
        edges=_TWO_HOPS,
        single_view=False,
    ),
    Template(
        "later_pose",
        ("2d", "actions"),
        ("multiple_choice", "action", ("t1",)),
        "asked",
        read=("t1",),
        decisive=("t1",),
        stated=("t0", "t1"),
        edges=_TWO_HOPS,
        pose_answer=True,
        shift="pose_shift",
        drop="pose_drop",
    ),
    Template(
        "gap",
        ("2d", "actions"),
        ("number", "seconds_between", ("t1", "t2")),
        "construction",
        read=("start", "start2"),
        decisive=("first", "first2"),
        answer=_VALUE,
        events=(*_START, ("t2", "start", "t0")),
        form="gap_starts",
    ),
    Template(
        "gap",
        ("2d",),
        ("number", "seconds_between", ("t1", "t2")),
        "construction",
        read=("leaves", "returns"),
        decisive=("leaves", "returns"),
        answer=_VALUE,
        events=(("t1", "leaves", "t0"), ("t2", "returns", "t1")),
        form="gap_absence",
    ),
    Template(
        "gap",
        ("2d",),
        ("number", "count", ("t1", "t2")),
        "construction",
        read=("t1", "t2"),
        decisive=("t1",),
        answer=_VALUE,
        stated=("t1", "t2"),
        form="gap_count",
    ),
    Template(
        "fork_join",
        ("2d", "actions"),
        ("multiple_choice", "action", ("t0",)),
        "program",
        read=("t0",),
        decisive=("t0",),
        edges=(("a", "b"), ("a", "c"), ("b", "d"), ("c", "d")),
        pose_answer=True,
    ),
)
"""The forms of all templates, in the order in which they are searched; a template's forms stand together."""


def by_name(templates: Sequence[Template]) -> dict[str, tuple[Template, ...]]:
    """The forms of each template, by its name."""
    return {name: tuple(forms) for name, forms in groupby(templates, key=lambda template: template.name)}


def query_text(folder: str, name: str) -> str:
    """The text of a packaged Cypher file."""
    return resources.files("jrdb_avr.queries").joinpath(folder, f"{name}.cypher").read_text(encoding="utf-8")


def query_values(rules: Rules) -> dict[str, int | float]:
    """Values of the parameters that the queries may use; frames, metres and degrees."""
    return {
        "wait": frames(rules.min_wait_s),
        "later": frames(rules.long_wait_s),
        "search": frames(rules.search_wait_s),
        "turn": rules.turn_deg,
        "gap": frames(rules.gap_min_s),
        "least": rules.count_min,
        "fps": FPS,
        "changed": rules.distance_changed_m,
        "same": rules.distance_same_m,
    }


def plan_texts(template: Template, columns: Mapping[str, pa.Array]) -> pa.Array:
    """Canonical plans of candidates, set-wise.

    `columns` holds `conditions` (as JSON, without brackets), one column of frames per stated time, one of relations
    per hop, and `action` and `action2` where the template asks for them.
    """
    # The longer mark first: it begins like the shorter one.
    holes = {'{"action":"?conditions","at":"t0"}': "conditions"}
    holes |= {mark: mark[1:] for mark in reversed(_ACTION_MARKS)}
    holes |= {f"?{name}": name for name in template.relations}
    holes |= {str(_FRAME_MARK + i): name for i, name in enumerate(template.stated)}
    pieces: list[pa.Array | str] = [canonical(template.skeleton())]
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
    # Of a text whose type is not told, Arrow looks for packages that know of dates, every time.
    parts = [
        pa.scalar(piece, pa.string()) if isinstance(piece, str) else pc.cast(piece, pa.string()) for piece in pieces
    ]
    return pc.binary_join_element_wise(*parts, pa.scalar("", pa.string()))
