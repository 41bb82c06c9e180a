"""The question templates. Each form of a template is one row with its plan, layers, proofs and paraphrases.

See "Add" in `docs/architecture.md` to add a template. A paraphrase has slots. `{who}` is the description, `{t0}` is a
stated time, and `{action1}` is an action. `{says1}`, `{the1}` and `{holds1}` are phrases of the first relation.
`{Says1}` has a capital letter. `{At}`, `{at}`, `{When}`, `{How}` and `{about}` say "about" if a time is approximate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import groupby
from typing import Final, Literal

from msgspec.structs import replace

from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import Use

TimeProof = Literal["times", "program", "construction"]
"""Part of a question that the proofs about time move.

times: the stated times after the description. The person stays the same. program: the time of the description, so that
all people are found again. construction: nothing, because the answer is itself a time.
"""


@dataclass(frozen=True, slots=True)
class Slots:
    """Variable parts of the text of a question.

    Attributes:
        conditions: Conditions of the described person.
        frames: Stated frames by name of the time.
        actions: Actions, in the order of the template.
        relations: Relations in the order of the edges, or the relation that is counted.
    """

    conditions: tuple[Condition, ...]
    frames: dict[str, int]
    actions: tuple[str, ...] = ()
    relations: tuple[str, ...] = ()


@dataclass(frozen=True)
class Template:
    """A form of a question template. Node a of its plan is the described person.

    Attributes:
        name: Name of the template. All forms of a template have the same name and are judged together.
        family: Family of the template.
        spec: Read of the answer.
        paraphrases: Texts of the question with slots.
        stated: Names of the stated times. The first is the time of the description.
        events: Other times by name. Their actions are `{1}` and `{2}`, the first and second action of the question.
        edges: Source and target of each relation.
        layers: Annotation layers that the template needs.
        time_proof: Part of the question that the proofs about time move.
        single_view: Whether one fixed view may show all that is needed for the answer.
        read: Names of the frames with the answer, as in `propose.Proposal`. The default is the times of `spec`.
        decisive: Names of the frames in which the target's boxes are decisive evidence. The default is `read`. If the
            target is absent from all of these frames, its box at the time of the description is decisive.
        form: Name of the form and of its generator query, or "" if it is the name of the template.
        seeks: Events that make a candidate. The first form of a template names the events of all forms.
    """

    name: str
    family: str
    spec: AnswerSpec
    paraphrases: tuple[str, ...]
    stated: tuple[str, ...] = ("t0",)
    events: Mapping[str, Time] = field(default_factory=dict)
    edges: tuple[tuple[str, str], ...] = ()
    layers: tuple[str, ...] = ("2d", "actions")
    time_proof: TimeProof = "construction"
    single_view: bool = True
    read: tuple[str, ...] = ()
    decisive: tuple[str, ...] = ()
    form: str = ""
    seeks: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "read", self.read or self.spec.times)
        object.__setattr__(self, "decisive", self.decisive or self.read)

    @property
    def query(self) -> str:
        """Name of the form, which is also the name of its generator query."""
        return self.form or self.name

    @property
    def described(self) -> str:
        """Name of the time of the description and of the edges."""
        return self.stated[0]

    @property
    def target(self) -> str:
        """Node that the answer is about."""
        return self.spec.of

    @property
    def people(self) -> tuple[str, ...]:
        """Nodes of the plan, in order."""
        return tuple(dict.fromkeys(("a", *(target for _, target in self.edges))))

    @property
    def joins(self) -> bool:
        """Whether two branches of relations lead to the target."""
        return len(self.edges) >= len(self.people)

    @property
    def hops(self) -> int:
        """Number of successive relations to the target. A fork-join has two, because its branches are parallel."""
        return len(self.edges) // (2 if self.joins else 1)

    @property
    def counts(self) -> bool:
        """Whether the answer is the number of people who have a relation with the target."""
        return self.spec.read == "count"

    @property
    def uses(self) -> tuple[Use, ...]:
        """Use of each relation in the text."""
        targets = [target for _, target in self.edges]
        hops: tuple[Use, ...] = tuple("hop" if targets.count(target) == 1 else "join" for target in targets)
        return (*hops, "count") if self.counts else hops

    @property
    def asks_action(self) -> bool:
        """Whether the answer is an action. The text of the question must not state this action."""
        return self.spec.read in ("action", "next_action")

    @property
    def answer(self) -> tuple[str, ...] | None:
        """JSON of the stored answer as a sequence of texts and columns. None if the answer is a choice."""
        return MODES[self.spec.mode].stored_json

    @property
    def actions(self) -> int:
        """Number of actions that the text names."""
        return len({time.action for time in self.events.values() if time.action is not None})

    def build(self, slots: Slots) -> Plan:
        """Return the plan of a text.

        Args:
            slots: Slots of the text.
        """
        named = {f"{{{i}}}": action for i, action in enumerate(slots.actions, 1)}
        events = {t: replace(e, action=named[e.action]) if e.action else e for t, e in self.events.items()}
        return Plan(
            root="a",
            target=self.target,
            times={name: Time(frame=frame) for name, frame in slots.frames.items()} | events,
            nodes=tuple(Node(id=name, conditions=slots.conditions if name == "a" else ()) for name in self.people),
            edges=tuple(
                Edge(source=source, relation=relation, target=target, at=self.described)
                for (source, target), relation in zip(self.edges, slots.relations, strict=False)
            ),
            answer=replace(self.spec, relation=slots.relations[0]) if self.counts else self.spec,
        )

    def slots(self, plan: Plan) -> Slots | None:
        """Return the slots of a plan's text. Return None if the plan lacks a part, so that it has another form.

        Args:
            plan: Plan.
        """
        frames = {name: plan.times[name].frame for name in self.stated if name in plan.times}
        actions = {e.action: plan.times[t].action for t, e in self.events.items() if e.action and t in plan.times}
        relations = (plan.answer.relation,) if self.counts else tuple(edge.relation for edge in plan.edges)
        root = next(node for node in plan.nodes if node.id == plan.root)
        slots = Slots(
            root.conditions,
            {name: frame for name, frame in frames.items() if frame is not None},
            tuple(action for _, action in sorted(actions.items()) if action is not None),
            tuple(relation for relation in relations if relation is not None),
        )
        sizes = len(slots.frames), len(slots.actions), len(slots.relations)
        return slots if sizes == (len(self.stated), self.actions, len(self.uses)) else None


def _start(of: str = "a", action: str = "{1}") -> Time:
    return Time(event="start", of=of, action=action, after="t0")


_STARTS: Final = {"t1": _start()}
_TWO_HOPS: Final = (("a", "b"), ("b", "c"))

_FIND: Final = "Find {who} at {t0}; call that person A. At that moment, {says1}. {Says2}. "
_SCENE: Final = "In the scene at {t0}, A is {who}. {Says1}. {Says2}. "
_STEPS: Final = "At {t0}, find A, {who}; then B, {the1}; and then C, {the2}. "
_ONE: Final = "Only one is true."
_ANGLES: Final = (
    "Panorama angles are in degrees: 0 is behind the robot, 90 is to the robot's left, 180 is straight ahead of the "
    "robot and 270 is to the robot's right."
)

_ROWS: Final = (
    Template(
        "start",
        "action_boundary",
        AnswerSpec(mode="frame", read="start", of="a", at="t1"),
        (
            "Find {who} at {t0}. {At} which frame does that person start {action1} for the first time after that?",
            "At {t0}, find {who}. Keep your eyes on that person from then on: {at} which frame does the person first "
            "start {action1}?",
            "Consider {who} at {t0}. {When} does that person first start {action1} after that moment? Give the frame.",
        ),
        events=_STARTS,
        read=("start",),
        decisive=("first",),
        seeks="somebody starts an action three seconds or more after being described, and keeps at it",
    ),
    Template(
        "span",
        "action_boundary",
        AnswerSpec(mode="span", read="span", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. {At} which frame does this person start {action1} for the first time after that, and "
            "{at} which frame does the person stop again?",
            "At {t0}, find {who}. Keep your eyes on that person from then on: {at} which frame does the person's first "
            "spell of {action1} begin, and {at} which frame does it end?",
            "Consider {who} at {t0}. From {about}which frame to {about}which frame is that person {action1} for the "
            "first time after that moment?",
        ),
        events={**_STARTS, "t2": Time(event="end", of="a", action="{1}", after="t1")},
        read=("start", "end"),
        decisive=("first", "last"),
        seeks="somebody starts an action three seconds or more after being described, keeps at it, and stops",
    ),
    Template(
        "change",
        "unique_anchor",
        AnswerSpec(mode="multiple_choice", read="action", of="a", at="t1"),
        (
            f"Find {{who}} at {{t0}}. Which of these is that person doing at {{t1}}? {_ONE}",
            f"At {{t0}}, find {{who}}. Which of these is this person doing later, at {{t1}}? {_ONE}",
            "Consider {who} at {t0}. When the video has reached {t1}, which of these is that person doing? " + _ONE,
        ),
        stated=("t0", "t1"),
        time_proof="times",
        seeks="a described person does something three seconds or more later, but not at the time of the description",
    ),
    Template(
        "presence",
        "unique_anchor",
        AnswerSpec(mode="multiple_choice", read="presence", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. Look again at {t1} and at {t2}: at which of these two times, if at either, can that "
            "person be seen?",
            "At {t0}, find {who}. Can this person be seen later only at {t1}, only at {t2}, at both times or at "
            "neither?",
            "Consider {who} at {t0}. Of the two later moments {t1} and {t2}, at which is that person visible, if at "
            "either?",
        ),
        layers=("2d",),
        stated=("t0", "t1", "t2"),
        time_proof="times",
        seeks="somebody described is known to be there or not at two later times",
    ),
    Template(
        "distance",
        "unique_anchor",
        AnswerSpec(mode="multiple_choice", read="distance_change", of="a", at=("t0", "t1")),
        (
            "Find {who} at {t0}. At {t1}, is that person closer to the robot than at that first moment, farther from "
            "it, at about the same distance (within a metre), or not in view?",
            "At {t0}, find {who}. How far from the robot is this person at {t1}, compared with that first moment: "
            "closer, farther, about the same (within a metre), or not in view?",
            "Consider {who} at {t0}. At {t1}, is that person's distance from the robot smaller than then, larger, "
            "about the same (within a metre), or is the person not in view?",
        ),
        layers=("2d", "3d"),
        stated=("t0", "t1"),
        decisive=("t1",),
        time_proof="times",
        seeks="somebody described comes nearer, goes farther, stays or leaves, measured by lidar",
    ),
    Template(
        "two_hop",
        "chain_2hop",
        AnswerSpec(mode="multiple_choice", read="action", of="c", at="t0"),
        (
            f"{_FIND}Which of these is C doing then? {_ONE}",
            f"{_SCENE}Which of these is C doing? {_ONE}",
            f"{_STEPS}Which of these is C doing at that moment? {_ONE}",
        ),
        edges=_TWO_HOPS,
        time_proof="program",
        seeks="from somebody described two certain relations lead on to a person of known actions",
    ),
    Template(
        "three_hop",
        "chain_3hop",
        AnswerSpec(mode="multiple_choice", read="action", of="d", at="t0"),
        (
            f"{_FIND}{{Says3}}. Which of these is D doing then? {_ONE}",
            f"{_SCENE}{{Says3}}. Which of these is D doing? {_ONE}",
            "At {t0}, find A, {who}; then B, {the1}; then C, {the2}; and then D, {the3}. Which of these is D doing at "
            f"that moment? {_ONE}",
        ),
        edges=(*_TWO_HOPS, ("c", "d")),
        time_proof="program",
        seeks="from somebody described three certain relations lead on to a person of known actions",
    ),
    Template(
        "fork_join",
        "chain_fork_join",
        AnswerSpec(mode="multiple_choice", read="action", of="d", at="t0"),
        (
            _FIND + "Leaving A, B and C aside, D is the only person who is {holds3} and who is also {holds4}. "
            f"Which of these is D doing then? {_ONE}",
            _SCENE + "Apart from A, B and C there is only one person, D, who is {holds3} and also {holds4}. "
            f"Which of these is D doing? {_ONE}",
            "At {t0}, find A, {who}; then B, {the1}; and C, {the2}. Not counting these three, only one person is "
            f"{{holds3}} and also {{holds4}}. Which of these is that person doing? {_ONE}",
        ),
        edges=(("a", "b"), ("a", "c"), ("b", "d"), ("c", "d")),
        time_proof="program",
        seeks="two ways from somebody described meet in one person, and neither alone singles that person out",
    ),
    Template(
        "action_search",
        "chain_hybrid",
        AnswerSpec(mode="frame_viewpoint", read="start_view", of="c", at="t1"),
        (
            _FIND + "{At} which frame does C start {action1} for the first time after that, and at which panorama "
            f"angle is C then? {_ANGLES}",
            _SCENE
            + "{When} does C first start {action1} after that moment, and in which direction from the robot is C "
            f"then? Give the frame and the panorama angle. {_ANGLES}",
            _STEPS + "Keep your eyes on C from then on: {at} which frame does C first start {action1}, and at which "
            f"panorama angle is C at that frame? {_ANGLES}",
        ),
        events={"t1": _start("c")},
        edges=_TWO_HOPS,
        read=("start",),
        decisive=("first",),
        single_view=False,
        seeks="two certain relations lead to somebody who starts an action later, in another direction",
    ),
    Template(
        "later_action",
        "long_range",
        AnswerSpec(mode="multiple_choice", read="action", of="c", at="t1"),
        (
            f"{_FIND}Which of these is C doing later, at {{t1}}? {_ONE}",
            f"{_SCENE}When the video has reached {{t1}}, which of these is C doing? {_ONE}",
            f"{_STEPS}Keep your eyes on C: which of these is C doing at {{t1}}? {_ONE}",
        ),
        stated=("t0", "t1"),
        edges=_TWO_HOPS,
        time_proof="times",
        seeks="two certain relations lead to a person who does something ten seconds later, but not at first",
    ),
    Template(
        "consequence",
        "long_range",
        AnswerSpec(mode="multiple_choice", read="next_action", of="a", at="t1"),
        (
            f"Find {{who}} at {{t0}}. Which of these does that person do next? {_ONE}",
            f"At {{t0}}, find {{who}}. Keep your eyes on that person: which of these does the person do next? {_ONE}",
            f"Consider {{who}} at {{t0}}. Which of these does that person do first after that moment? {_ONE}",
        ),
        events={"t1": Time(event="end", of="a", after="t0")},
        read=("start",),
        decisive=("first",),
        seeks="somebody holds a pose for ten seconds, and the next one follows at once and lasts",
    ),
    Template(
        "gap",
        "long_range",
        AnswerSpec(mode="number", read="seconds_between", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. After that moment, {about}how many seconds pass between the first time that this "
            "person starts {action1} and the first time that the person starts {action2}?",
            "At {t0}, find {who}. Keep your eyes on that person from then on: the person starts {action1}, and later "
            "starts {action2}, each for the first time since that moment. {How} many seconds lie between the two "
            "starts?",
            "Consider {who} at {t0}, and only what begins after that moment. {How} many seconds pass from when that "
            "person first starts {action1} until the same person first starts {action2}?",
        ),
        events={**_STARTS, "t2": _start(action="{2}")},
        read=("start", "start2"),
        decisive=("first", "first2"),
        form="gap_starts",
        seeks="somebody described starts two actions five seconds apart, or is away for five "
        "seconds, or is in one relation with four people or more",
    ),
    Template(
        "gap",
        "long_range",
        AnswerSpec(mode="number", read="seconds_between", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t0}. Later, this person goes out of view for the first time after that, and comes back "
            "after a while. {How} many seconds pass from when the person is last seen until the person is seen again?",
            "At {t0}, find {who}. Keep your eyes on that person: {about}how many seconds does the first absence from "
            "view after that moment last, from when the person is last seen to when the person is seen again?",
            "Consider {who} at {t0}. That person stays in view for some time, is then out of view, and is later in "
            "view again. {How} many seconds pass from the last moment in view before this first absence to the first "
            "moment in view after it?",
        ),
        layers=("2d",),
        events={"t1": Time(event="leaves", of="a", after="t0"), "t2": Time(event="returns", of="a", after="t1")},
        read=("leaves", "returns"),
        form="gap_absence",
    ),
    Template(
        "gap",
        "long_range",
        AnswerSpec(mode="number", read="count", of="a", at=("t1", "t2")),
        (
            "Find {who} at {t1}. From then until {t2}, how many other people are, at one moment or another, {holds1}?",
            "At {t1}, find {who}. Count all the other people who are {holds1} at any moment from then until {t2}. How "
            "many are there?",
            "Consider {who} at {t1}, and all the time from then until {t2}. How many different people, not counting "
            "the one described, are at some moment {holds1}?",
        ),
        layers=("2d",),
        stated=("t1", "t2"),
        decisive=("t1",),
        form="gap_count",
    ),
)

TEMPLATES: Final[dict[str, Template]] = {row.query: row for row in _ROWS}
"""Rows by the name of the form, in the order of the search. The forms of a template follow each other."""

FORMS: Final = {name: tuple(rows) for name, rows in groupby(_ROWS, key=lambda row: row.name)}
"""Forms of each template by the name of the template."""

FAMILIES: Final = {name: forms[0].family for name, forms in FORMS.items()}
"""Family of each template by the name of the template."""


def forms_of(name: str) -> tuple[Template, ...]:
    """Return the forms of a template.

    Args:
        name: Name of the template.

    Raises:
        PlanError: If the name is unknown.
    """
    if name not in FORMS:
        raise PlanError("template", f"{name!r} is no template; use one of {', '.join(FORMS)}")
    return FORMS[name]
