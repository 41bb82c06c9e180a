"""What a question asks about the person whom it leads to: poses, frames, angles, numbers and choices."""

from __future__ import annotations

from dataclasses import dataclass

from text_reader_facts import Facts, turn
from text_reader_labels import Recording, Seen
from text_reader_vocabulary import FPS, PARTNERS, POSES
from text_reader_words import Question


class ConfusedError(Exception):
    """The reader finds nobody, several people or no answer; the message says which."""


def only(fits: dict, name: str):
    """The one who certainly fits while nobody else could."""
    possible = [one for one, fact in fits.items() if fact is not False]
    if len(possible) > 1:
        raise ConfusedError(f"{name}: several fit: {sorted(possible)}")
    if not possible or not fits[possible[0]]:
        raise ConfusedError(f"{name}: nobody certainly fits")
    return possible[0]


@dataclass
class Asked:
    """A question about one person under one reading."""

    question: Question
    choices: list[str]
    facts: Facts
    person: int

    @property
    def recording(self) -> Recording:
        return self.facts.recording

    def answer(self) -> dict:
        return getattr(self, f"read_{self.question.read}")()

    def seen(self, frame: int) -> Seen | None:
        return self.facts.seen(self.person, frame)

    def later(self) -> list[int]:
        return [frame for frame in self.recording.order if frame > self.question.frame]

    def read_pose(self, frame: int | None = None) -> dict:
        frame = frame if frame is not None else (*self.question.values, self.question.frame)[0]
        chosen = only({choice: self.facts.doing(self.person, frame, choice) for choice in self.choices}, "choices")
        return self.choice(chosen)

    def choice(self, words: str) -> dict:
        return {"choice": self.choices.index(words) + 1}

    def read_next_pose(self) -> dict:
        def pose(frame: int) -> str | None:
            """The one pose that is certain at a frame."""
            listed = (self.seen(frame) or Seen(None)).actions
            poses = [label for label in POSES.values() if label in listed]
            return poses[0] if len(poses) == 1 and listed[poses[0]] < 3 else None

        first = pose(self.question.frame)
        return self.read_pose(next((frame for frame in self.later() if pose(frame) not in (None, first)), -1))

    def spell(self, phrase: str) -> tuple[int, int]:
        """First and last frame of the first spell of an action after the description."""
        longest, first, last, before = max(self.facts.reading.pause, self.recording.step), None, 0, self.question.frame
        for frame in self.later():
            if first is not None and frame - last > longest:
                break
            if (seen := self.seen(frame)) is None:
                continue
            if self.does(seen, phrase, frame):
                if first is None and frame - before > FPS:
                    raise ConfusedError(f"nobody sees the start of {phrase}")
                first, last = frame if first is None else first, frame
            before = frame
        if first is None:
            raise ConfusedError(f"never {phrase}")
        return first, last

    def does(self, seen: Seen, phrase: str, frame: int) -> bool:
        if not self.facts.labels(phrase) & seen.actions.keys():
            return False
        fact = self.facts.doing(self.person, frame, phrase)
        if fact is None and self.facts.reading.spell == "possible":
            return True
        return fact is True

    @property
    def half(self) -> int:
        """What lies between the first label and the start: half a step where labels come once per second."""
        return self.recording.step // 2

    def read_start(self) -> dict:
        return {"frame": self.spell(self.question.values[0])[0] - self.half}

    def read_span(self) -> dict:
        first, last = self.spell(self.question.values[0])
        return {"start_frame": first - self.half, "end_frame": last + self.half}

    def read_view(self) -> dict:
        first, _ = self.spell(self.question.values[0])
        angle, before = self.facts.people(first)[self.person].angle, self.seen(first - self.recording.step)
        if self.facts.reading.moment == "between" and before is not None:
            angle = (before.angle + turn(angle - before.angle) / 2) % 360
        return {"frame": first - self.half, "angle_deg": angle}

    def read_starts(self) -> dict:
        one, two = (self.spell(phrase)[0] for phrase in self.question.values)
        return {"value": (two - one) / FPS}

    def read_absence(self) -> dict:
        last = self.question.frame
        strangers = False
        for frame in self.later():
            clear = self.facts.reading.seen != "clear" or self.facts.visible(self.person, frame)
            if self.seen(frame) is None or not clear:
                strangers = strangers or self.facts.strangers(frame)
                continue
            if frame - last > 2 * max(self.recording.step, FPS):
                if strangers:
                    raise ConfusedError("a record without a number may be of the absent person")
                return {"value": (frame - last) / FPS}
            last, strangers = frame, False
        raise ConfusedError("never away and back")

    def read_count(self) -> dict:
        words, end = self.question.values
        label = PARTNERS.get(words, "")
        frames = [self.question.frame, *(frame for frame in self.later() if frame <= end)]
        met = {other for frame in frames for other in self.facts.people(frame) if self.meets(other, frame, label)}
        return {"value": float(len(met - {self.person}))}

    def meets(self, other: int, frame: int, label: str) -> bool:
        if label:
            return self.facts.together(self.person, other, frame, label) is True
        one, two = self.seen(frame), self.facts.seen(other, frame)
        if self.facts.reading.spell == "possible":
            return one is not None and two is not None and one.group is not None and one.group == two.group
        return self.facts.same_group(self.person, other, frame) is True

    def visible(self, frame: int) -> bool:
        if (fact := self.facts.visible(self.person, frame)) is None:
            raise ConfusedError("a record without a number may be of the person")
        return fact

    def read_presence(self) -> dict:
        first, second = (self.visible(frame) for frame in self.question.values)
        if first == second:
            return self.choice("both times" if first else "neither time")
        return self.choice("only at the first time" if first else "only at the second time")

    def read_distance(self) -> dict:
        later = self.question.values[0]
        if not self.visible(later):
            return self.choice("not in view")
        one, two = self.facts.metres(self.person, self.question.frame), self.facts.metres(self.person, later)
        if one is None or two is None:
            raise ConfusedError("a distance is unknown")
        if abs(two - one) < 1:
            return self.choice("about the same distance")
        return self.choice("closer to the robot" if two < one else "farther from the robot")
