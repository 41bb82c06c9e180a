"""A method that sees perfectly and looks as often as it likes: what it cannot answer, nobody can by looking.

It reads the question's text (the public inverse of the wording), calls `observe`, and is told by a `Teller` what is
certainly true of the people with a clear view inside each crop; the store is never opened. It takes what it sees for
all there is: the only one seen who fits a description is the one described, and who is not seen is away.
"""

from __future__ import annotations

import math

import pyarrow as pa
from oracle_facts import distance_words, person_sectors
from oracle_words import POSES

from jrdb_avr.engine.report.answer_key import AnswerKey
from jrdb_avr.engine.report.scoring import score_predictions
from jrdb_avr.engine.run.answering import answer_one
from jrdb_avr.schema.answers import Choice, Evidence, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.method import Prediction
from jrdb_avr.schema.tables import RUNS
from jrdb_avr.schema.wording.text import parse

STEP = 15
QUIET = 45
"""Frames without an action after which a stretch of it has ended."""
FIRST = {"first to the left of (robot view)": -1, "first to the right of (robot view)": 1}
WINDOWS = {
    f"within {degrees} degrees to the {side} of (robot view)": (degrees, turn)
    for degrees in (30, 45, 60, 90)
    for side, turn in (("left", -1), ("right", 1))
}
GROUP = "in the same group as"
SMALLER, LARGER, SAME, AWAY = (
    "closer to the robot",
    "farther from the robot",
    "about the same distance",
    "not in view",
)
SPOKEN = {"bending": "bending down", "lying": "lying down", "scootering": "riding a scooter"}
"""Postures that choices say in other words."""
PRESENCE = {
    (True, True): "both times",
    (True, False): "only at the first time",
    (False, True): "only at the second time",
    (False, False): "neither time",
}


class LostError(Exception):
    """What was seen does not answer the question."""


class PerfectPerception:
    """The method; `teller(observation)` gives a list of `fact_teller.Seen`."""

    name = "perfect"

    def __init__(self, teller):
        self.teller = teller

    def answer(self, task):
        eyes = Eyes(task, self.teller)
        try:
            found, seen = Solver(task, eyes).solve()
            seen = eyes.whole(seen)
        except LostError as error:
            return Prediction("invalid", reason=str(error), n_observations=eyes.looks)
        return Prediction(
            "answered", found, Evidence(seen.frame, tuple(map(float, seen.box))), n_observations=eyes.looks
        )


class Eyes:
    """Looks, and remembers everybody seen, by frame and name."""

    def __init__(self, task, teller):
        self.task, self.teller = task, teller
        self.frames = task.sequence.frames
        self.looks = 0
        self.seen = {}
        self.all_round = set()

    def look(self, frame, angle):
        observation = self.task.observe(self.task.question.sequence, frame, angle)
        self.looks += 1
        here = self.seen.setdefault(frame, {})
        for seen in self.teller(observation):
            if seen.name not in here or seen.box[2] > here[seen.name].box[2]:
                here[seen.name] = seen

    def whole(self, seen):
        """The same person with the whole box: looked at again where a crop's edge may have cut it."""
        if seen.cut:
            x, _, w, _ = seen.box
            self.look(seen.frame, ((x + w - 240) if seen.cut < 0 else (x + 240)) / 3760 * 360)
        return self.seen[seen.frame][seen.name]

    def survey(self, frame):
        """Everybody in view, with whole boxes."""
        if frame not in self.frames:
            raise LostError(f"frame {frame} cannot be looked at")
        if frame not in self.all_round:
            self.all_round.add(frame)
            for turn in range(8):
                self.look(frame, 45.0 * turn)
            for seen in list(self.seen[frame].values()):
                self.whole(seen)
        return list(self.seen[frame].values())

    def find(self, frame, name, angle):
        """Somebody known, first where it was last; None where it is not in view."""
        if name not in self.seen.get(frame, {}) and frame not in self.all_round:
            self.look(frame, angle)
            if name not in self.seen[frame]:
                self.survey(frame)
        return self.seen[frame].get(name)

    def track(self, name, frames, angle):
        """(frame, the person or None) at each of these frames, looking first where it was before."""
        for frame in frames:
            seen = self.find(frame, name, angle)
            if seen is not None:
                angle = seen.angle
            yield frame, seen

    def between(self, first, last):
        """Frames with a picture after `first` and before `last`."""
        return [frame for frame in self.frames if first < frame < last]

    def keyframes(self, after):
        return [frame for frame in self.frames if frame > after and frame % STEP == 0]


class Solver:
    """One question's plan, carried out by looking."""

    def __init__(self, task, eyes):
        self.eyes, self.question = eyes, task.question
        self.fps = task.sequence.fps
        _, self.plan = parse(task.question.question)
        self.start = min(self._described_at())
        self.people = {}
        self.events = {}

    def _described_at(self):
        """The frames at which the plan's conditions and edges hold; without any, the first that is stated."""
        times = self.plan.times
        names = {condition.at for node in self.plan.nodes for condition in node.conditions if condition.at}
        names |= {edge.at for edge in self.plan.edges}
        return [times[name].frame for name in names] or [t.frame for t in times.values() if t.frame is not None]

    def solve(self):
        self._who()
        target = self.people[self.plan.target]
        return getattr(self, f"_{self.plan.answer.read}")(target, *self.plan.answer.times)

    def _who(self):
        """Everybody in the plan, from the one described on."""
        everybody = self.eyes.survey(self.start)
        for node in self.plan.nodes:
            edges = [edge for edge in self.plan.edges if edge.target == node.id]
            met = {seen.name for seen in self.people.values()}
            fits = [
                seen
                for seen in everybody
                if seen.name not in met
                and all(holds(condition, seen) for condition in node.conditions)
                and all(related(edge.relation, self.people[edge.source], seen, everybody) for edge in edges)
            ]
            if len(fits) != 1:
                raise LostError(f"{len(fits)} people could be {node.id}")
            self.people[node.id] = fits[0]

    def _choice(self, answer):
        text = SPOKEN.get(answer, answer)
        if text not in self.question.choices:
            raise LostError(f"{text!r} is none of the choices")
        return Choice(self.question.choices.index(text) + 1)

    # -- times --

    def _frame(self, name):
        """The frame of a time: stated, or that of an event."""
        return self._event(name)[0]

    def _event(self, name):
        """(frame, the person then or None) of a time."""
        if name not in self.events:
            time = self.plan.times[name]
            if time.frame is not None:
                who = self.people[self.plan.target]
                self.events[name] = time.frame, self.eyes.find(time.frame, who.name, who.angle)
            else:
                who, after = self.people[time.of], self._frame(time.after)
                find = {"start": self._starts, "end": self._ends, "leaves": self._leaves, "returns": self._returns}
                self.events[name] = find[time.event](who, after, time.action)
        return self.events[name]

    def _starts(self, who, after, action):
        before = after
        for key, seen in self.eyes.track(who.name, self.eyes.keyframes(after), who.angle):
            if seen is not None and action in seen.doing:
                last = before
                for frame, then in self.eyes.track(who.name, [*self.eyes.between(before, key), key], seen.angle):
                    if then is not None and action in then.doing:
                        return (last + 1 + frame) // 2, then
                    last = frame
            before = key
        raise LostError(f"never starts {action}")

    def _ends(self, who, after, action):
        last, ended, there = after, None, who
        for key, seen in self.eyes.track(who.name, self.eyes.keyframes(after - 1), who.angle):
            if seen is not None and action in seen.doing:
                last, ended, there = key, None, seen
            else:
                ended = ended or key
            if key - last > QUIET:
                break
        if ended is None:
            raise LostError(f"never ends {action}")
        key = ended
        for frame, seen in self.eyes.track(who.name, self.eyes.between(last, key), there.angle):
            if seen is not None and action in seen.doing:
                last, ended, there = frame, key, seen
            else:
                ended = min(ended, frame)
        return (last + ended - 1) // 2, there

    def _leaves(self, who, after, _):
        last = self.eyes.find(after, who.name, who.angle)
        for key, seen in self.eyes.track(who.name, self.eyes.keyframes(after), who.angle):
            if seen is None:
                for _, then in self.eyes.track(who.name, self.eyes.between(last.frame, key), last.angle):
                    last = then or last
                return last.frame, last
            last = seen
        raise LostError("never leaves")

    def _returns(self, who, after, _):
        before = after
        for key, seen in self.eyes.track(who.name, self.eyes.keyframes(after), who.angle):
            if seen is not None:
                for frame, then in self.eyes.track(who.name, self.eyes.between(before, key), seen.angle):
                    if then is not None:
                        return frame, then
                return key, seen
            before = key
        # Who comes back after the last keyframe is seen at a frame between.
        for frame, then in self.eyes.track(who.name, self.eyes.between(before, math.inf), who.angle):
            if then is not None:
                return frame, then
        raise LostError("never returns")

    # -- reads --

    def _action(self, who, at):
        _, seen = self._event(at)
        if seen is None or seen.pose is None:
            raise LostError("the posture cannot be seen")
        return self._choice(seen.pose), seen

    def _next_action(self, who, at):
        for _, seen in self.eyes.track(who.name, self.eyes.keyframes(self.start), who.angle):
            if seen is not None and seen.pose not in (None, who.pose):
                return self._choice(seen.pose), seen
        raise LostError("the posture never changes")

    def _presence(self, who, first, second):
        (_, one), (_, two) = self._event(first), self._event(second)
        return self._choice(PRESENCE[one is not None, two is not None]), one or two or who

    def _distance_change(self, who, first, second):
        (_, one), (_, two) = self._event(first), self._event(second)
        if two is None:
            return self._choice(AWAY), one
        if None in (one.distance, two.distance):
            raise LostError("a distance is not known")
        by = two.distance - one.distance
        return self._choice(SAME if abs(by) < 1 else LARGER if by > 0 else SMALLER), two

    def _start(self, who, at):
        frame, seen = self._event(at)
        return FrameAnswer(frame), seen

    def _span(self, who, first, second):
        (start, seen), (end, _) = self._event(first), self._event(second)
        return Span(start, end), seen

    def _start_view(self, who, at):
        frame, seen = self._event(at)
        seen = self.eyes.whole(seen)
        return FrameViewpoint(frame, seen.angle), seen

    def _seconds_between(self, who, first, second):
        (start, seen), (end, _) = self._event(first), self._event(second)
        return Number((end - start) / self.fps), seen

    def _count(self, who, first, second):
        relation, others = self.plan.answer.relation, set()
        frames = [frame for frame in self.eyes.keyframes(self._frame(first) - 1) if frame <= self._frame(second)]
        for frame in frames:
            everybody = self.eyes.survey(frame)
            for me in everybody:
                if me.name == who.name:
                    others |= {o.name for o in everybody if o is not me and related(relation, me, o, everybody)}
        return Number(float(len(others))), who


def holds(condition, seen):
    """Whether a condition is seen to be true of somebody."""
    if condition.action is not None:
        return condition.action in seen.doing and (condition.action not in POSES or seen.pose == condition.action)
    if condition.object is not None:
        return (condition.object, condition.verb) in seen.handles
    if condition.interaction is not None:
        return condition.interaction in {label for label, _ in seen.ties}
    told = {"sector": seen.sector, "distance": seen.distance_word, "group_size": seen.group_size}
    told |= {"gender": seen.gender, "age": seen.age}
    return told[condition.attribute] == condition.value


def related(relation, source, target, everybody):
    """Whether a relation leads from one person seen to another one in the same frame."""
    if source.name == target.name:
        return False
    if relation in FIRST:
        turns = {one.name: turn(source, one, FIRST[relation]) for one in everybody if one.name != source.name}
        return turns[target.name] == min(turns.values()) and turns[target.name] <= 60
    if relation in WINDOWS:
        degrees, side = WINDOWS[relation]
        return 0 < turn(source, target, side) < degrees
    if relation == GROUP:
        return source.group is not None and source.group == target.group
    if ", " in relation:
        return beside(source, target) == relation
    return (relation, target.name) in source.ties


def turn(source, target, side):
    """Degrees from one person to another, to the left (-1) or right (1) as the robot sees it."""
    return side * (target.angle - source.angle) % 360


def beside(source, target):
    """Where somebody is in another's own frame, where that is certain."""
    if None in (source.place, target.place):
        return None
    dx, dy, dz = (b - a for a, b in zip(source.place, target.place, strict=True))
    bearing = math.degrees(math.atan2(dy, dx) - source.heading)
    sectors = [name for name, sure in person_sectors((bearing + 180) % 360 - 180).items() if sure]
    word, other = distance_words(math.sqrt(dx * dx + dy * dy + dz * dz))
    return f"{sectors[0]}, {word}" if sectors and other is None else None


def no_panorama(sequence, frame):
    raise AssertionError("perfect perception looks at crops")


def take(store, teller, questions, sequences, observe):
    """Ask the questions, and judge them as the engine does: rows of dicts, in the questions' order."""
    method = PerfectPerception(teller)
    done = [
        answer_one(method, question.to_question(), sequences[question.sequence], observe, no_panorama).prediction
        for question in questions
    ]
    table = pa.Table.from_pylist([{"run_id": "perfect", **row} for row in done], schema=RUNS["predictions"])
    asked = [question.question_id for question in questions]
    scores = score_predictions(AnswerKey(store).truth(), "perfect", asked, table)
    return [
        {**row, **score, "template": question.template, "question": question.question}
        for question, row, score in zip(questions, done, scores.to_pylist(), strict=True)
    ]
