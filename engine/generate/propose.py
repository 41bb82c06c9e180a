"""Proposals of questions: the rows of the generators, as plans that are not proven yet.

A generator is a statement in `queries/generators`. Its rows have what one row decides: descriptions, relations that
lead to single people, clear views, images, waits, answers, and that the view straight ahead is not enough. Two forms
add people here: a fork-join adds the target of both branches, and a count adds the people who are counted.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import product
from typing import Final, cast

import msgspec
from msgspec.structs import replace

from jrdb_avr.engine.generate.choices import different_labels, true_labels
from jrdb_avr.engine.generate.facts import Fit
from jrdb_avr.engine.generate.layer import Layer, TableRow
from jrdb_avr.engine.generate.programs import Answer, Program, make_program
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.labels import PRESENCE_ANSWERS
from jrdb_avr.schema.plan import Condition, Plan, canonical
from jrdb_avr.schema.relations import RELATIONS, RELATIONS_OF
from jrdb_avr.schema.rules import frames
from jrdb_avr.schema.templates import Slots, Template
from jrdb_avr.schema.wording.people import in_order

_TIMES: Final = ("t0", "t1", "t2", "leaves", "returns")
"""Columns of times in rows of generators."""

_in_order = lru_cache(maxsize=4096)(in_order)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A question that is not proven yet.

    Attributes:
        layer: Layer of the sequence.
        template: Form of the template.
        row: Row of a generator: id of the name, people, times, relations, ids of segments, and answer or value.
    """

    layer: Layer
    template: Template
    row: TableRow

    @property
    def sequence(self) -> str:
        """Name of the sequence."""
        return self.layer.sequence

    @property
    def target(self) -> int:
        """Track of the person that the answer is about."""
        return int(self.row[self.template.target])

    @cached_property
    def people(self) -> dict[str, int]:
        """Tracks by name in the plan."""
        return {node: self.row[node] for node in self.template.people}

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Conditions of the description, in the order in which proofs leave them out."""
        at = self.template.described
        return tuple(c if c.at in (None, at) else replace(c, at=at) for c in self.layer.names[self.row["name"]])

    @cached_property
    def segments(self) -> list[TableRow]:
        """Segments of the actions."""
        return [self.layer.segments[self.row[name]] for name in ("segment", "segment2") if name in self.row]

    @cached_property
    def frames(self) -> dict[str, int]:
        """Frames by name: stated times, and `start`, `end`, `first`, `last`, `leaves` and `returns` of events."""
        times: dict[str, int] = {name: self.row[name] for name in _TIMES if name in self.row}
        for suffix, segment in zip(("", "2"), self.segments, strict=False):
            times |= {f"{name}{suffix}": segment[name] for name in ("first", "last", "start", "end")}
        times.setdefault("t0", times.get("t1", 0))
        return times

    @property
    def read(self) -> tuple[int, ...]:
        """Frames at which the answer is read."""
        return tuple(self.frames[name] for name in self.template.read)

    @cached_property
    def relations(self) -> tuple[str, ...]:
        """Relations of the text."""
        return tuple(self.row[f"r{number}"] for number, _ in enumerate(self.template.uses, start=1))

    @property
    def actions(self) -> tuple[str, ...]:
        """Actions of the text."""
        return tuple(segment["action"] for segment in self.segments)[: self.template.actions]

    @cached_property
    def answer(self) -> str:
        """Text of a choice, or the stored JSON of another answer."""
        if self.template.answer is None:
            return str(self.row["answer"])
        values = {name: str(frame) for name, frame in self.frames.items()}
        values |= {name: msgspec.json.encode(self.row[name]).decode() for name in ("value",) if name in self.row}
        if self.segments:
            values["angle"] = msgspec.json.encode(self.segments[0]["angle"]).decode()
        return "".join(values.get(piece, piece) for piece in self.template.answer)

    @property
    def counted(self) -> Sequence[Sequence[int]]:
        """People who are counted, each with the first frame that shows that person and the target clearly."""
        counted: Sequence[Sequence[int]] = self.row.get("counted", ())
        return counted

    @cached_property
    def plan(self) -> Plan:
        """Plan of the question."""
        stated = {name: self.frames[name] for name in self.template.stated}
        return self.template.build(Slots(_in_order(self.conditions), stated, self.actions, self.relations))

    @cached_property
    def key(self) -> str:
        """Hash of sequence, target and plan. It decides among equally good proposals."""
        return hashlib.sha256(f"{self.sequence}\n{self.target}\n{canonical(self.plan)}".encode()).hexdigest()


def propose(layer: Layer, template: Template) -> Iterable[TableRow]:
    """Return the rows of the proposals of a form of a template.

    Args:
        layer: Layer of the sequence.
        template: Form of the template, any but presence.

    Returns:
        The rows of proposals, in an order that means nothing.
    """
    if template.query == "fork_join":
        return _fork_joins(layer, template)
    return _counts(layer) if template.query == "gap_count" else layer.search(template.query)


def program_of(proposal: Proposal) -> tuple[Program, Answer]:
    """Return the program of a proposal, with the conditions in the order of the description, and the answer."""
    program = make_program(proposal.sequence, proposal.plan, proposal.template)
    answer, mode = proposal.answer, proposal.template.spec.mode
    start = cast(FrameViewpoint, decode_answer(mode, answer)) if mode == "frame_viewpoint" else None
    return replace(program, conditions=proposal.conditions), start or answer


# -- forms that need more than a statement ----------------------------------------------------------------------------


def _fork_joins(layer: Layer, template: Template) -> Iterator[TableRow]:
    """Yield the forks with the fourth person that both branches find together, but neither branch alone."""
    facts = layer.facts
    for row in layer.search(template.query):
        frame, apart = row["t0"], {row["a"], row["b"], row["c"]}
        people = facts.people[frame]
        sides = [_joining(layer, row[node], frame, apart) for node in ("b", "c")]
        for (r3, left), (r4, right) in product(*(side.items() for side in sides)):
            could, certain = left.could & right.could, left.certain & right.certain
            if len(could) != 1 or len(certain) != 1:
                continue
            (track,) = certain
            if not people[track]["clear"] or layer.boxes[track, frame]["ahead"]:
                continue
            first, *branches = (different_labels(facts.labels(row[node], frame)) for node in "abc")
            for label in sorted(true_labels(facts.lists[track], frame)):
                if label in first and any(label in different for different in branches):
                    yield row | {"d": track, "r3": r3, "r4": r4, "answer": label}


_WINDOWS: Final = tuple(label for label in RELATIONS_OF["join"] if RELATIONS[label].kind == "window")


def _joining(layer: Layer, track: int, frame: int, apart: set[int]) -> dict[str, Fit]:
    """Return the relations of a person that certainly fit a person and may fit two, apart from some people."""
    facts, fits = layer.facts, {}
    held = [label for label in facts.relations_of(track, frame) if label in RELATIONS_OF["join"]]
    for label in (*held, *_WINDOWS):
        could, certain = facts.follow(label, track, frame)
        if certain - apart and len(could - apart) >= 2:
            fits[label] = Fit(could - apart, certain - apart)
    return fits


def _counts(layer: Layer) -> Iterator[TableRow]:
    """Yield the people in a relation with a described person, from keyframe to keyframe until one is unknown.

    The proof checks the frames between keyframes.
    """
    facts, stretches = layer.facts, cache(lambda *start: list(_stretches(layer, *start)))
    held = cache(lambda track: {label for frame in facts.lists[track] for label in facts.relations_of(track, frame)})
    for row in layer.search("described"):
        if row["ahead"]:
            continue
        sized = any(condition.kind == "group_size" for condition in layer.names[row["name"]])
        for relation in RELATIONS_OF["count"]:
            # The words of a question with the size of a group would state the number of people at the beginning.
            if relation in held(row["a"]) and not (sized and RELATIONS[relation].kind == "group"):
                yield from (row | stretch for stretch in stretches(relation, row["a"], row["t0"]))


def _stretches(layer: Layer, relation: str, track: int, begin: int) -> Iterator[TableRow]:
    """Yield the stretches of time from a keyframe with enough people in a relation with a person."""
    facts, rules, met = layer.facts, layer.rules, dict[int, int | None]()
    for frame in facts.keyframes[bisect_left(facts.keyframes, begin) :]:
        people = facts.people.get(frame, {})
        if track not in people:
            return
        could, certain = facts.follow(relation, track, frame)
        clear = {other for other in certain if people[other]["clear"] and people[track]["clear"]}
        if could != certain or (facts.judges_views and clear != certain):
            return
        for other in certain:
            if met.setdefault(other, None) is None and other in clear:
                if not layer.has_image(frame):
                    return
                met[other] = frame
        if len(met) >= rules.count_min and None not in met.values() and frame >= begin + frames(rules.long_wait_s):
            counted = tuple(sorted(met.items()))
            yield {"t1": begin, "t2": frame, "r1": relation, "value": float(len(met)), "counted": counted}


def propose_presence(layer: Layer, template: Template) -> tuple[dict[int, list[TableRow]], dict[int, list[TableRow]]]:
    """Find the descriptions of people, and the pairs of times at which a person is present or absent.

    Args:
        layer: Layer of the sequence.
        template: Template presence.

    Returns:
        Rows of descriptions, and rows of pairs of times, by track. A row of one kind and a row of the other kind make a
        row of a proposal. The key `away` says whether the person is absent at both times.
    """
    described: dict[int, list[TableRow]] = defaultdict(list)
    pairs: dict[int, list[TableRow]] = defaultdict(list)
    for row in layer.search("described"):
        described[row["a"]].append(row)
    for row in layer.search(template.query):
        answer = PRESENCE_ANSWERS[3 - 2 * row["first"] - row["second"]]
        pairs[row["a"]].append(row | {"answer": answer, "away": row["first"] + row["second"] == 0})
    return described, pairs
