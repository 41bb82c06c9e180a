"""With whom people are in a relation over time: whom they meet from a keyframe on, as long as it is known.

At a keyframe it is known who is in a relation with a person where the person has a box and those who could be in it are
exactly those who certainly are. A *company* is a person's from one keyframe to the last one through which that is
known; it *meets* everybody who is in the relation at any keyframe of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.rules import Rules, frames

from .relations import GROUP, KIND, RELATIONS, SOCIAL, Facts, untold_others
from .scene import NOBODY, Bools, Ints, Scene


@dataclass(frozen=True)
class Meeting:
    """Somebody met: track, and the first keyframe at which both can be seen; NOBODY where there is none."""

    track: int
    seen: int


@dataclass(frozen=True)
class Company:
    """Companies long and large enough to be asked about, and whom they meet, sorted by company and person.

    moment, relation, until: per company the moment at which it begins, the relation, and the last keyframe's frame.
    owner, person, met, seen: per meeting the company, whom, and from which frame on: at all, and both in clear view.
    """

    moment: Ints
    relation: Ints
    until: Ints
    owner: Ints
    person: Ints
    met: Ints
    seen: Ints

    def tables(self, scene: Scene) -> dict[str, pa.Table]:
        """The graph's tables `Company`, `Keeps` and `Meets`."""
        number = np.arange(len(self.moment))
        relation = pc.take(pa.array(RELATIONS), pa.array(self.relation))
        image = scene.has_image(self.seen)
        return {
            "Company": pa.table({"id": number, "relation": relation, "until": self.until}),
            "Keeps": pa.table({"from": self.moment, "to": number}),
            "Meets": pa.table(
                {
                    "from": self.owner,
                    "to": self.person,
                    "met": self.met,
                    "seen": pa.array(self.seen, mask=self.seen == NOBODY),
                    "image": image,
                }
            ),
        }

    def meetings(self, scene: Scene, company: int, until: int) -> tuple[Meeting, ...]:
        """Everybody met by a frame, by track."""
        rows = np.arange(*np.searchsorted(self.owner, [company, company + 1]))
        rows = rows[self.met[rows] <= until]
        return tuple(Meeting(int(scene.tracks[self.person[row]]), int(self.seen[row])) for row in rows)


def find_company(scene: Scene, facts: Facts, rules: Rules) -> Company:
    """Companies that begin at any moment and reach over `long_wait_s`, meeting `count_min` people or more."""
    count = len(scene.keyframes)
    counted = np.flatnonzero(np.isin(KIND[facts.relation], (SOCIAL, GROUP)))
    source, relation = facts.source[counted], facts.relation[counted]
    # Lines: a person with a relation; pairs: a line with a partner. Both are followed over all keyframes.
    lines, line = np.unique(source // count * len(RELATIONS) + relation, return_inverse=True)
    partner = facts.target[counted] // count
    pairs, pair = np.unique(line * len(scene.tracks) + partner, return_inverse=True)
    keyframe = source % count
    until = _known_until(scene, facts, counted, lines, line)
    certain = np.zeros((len(pairs), count), bool)
    certain[pair, keyframe] = facts.certain[counted]
    of_line, other = pairs // len(scene.tracks), pairs % len(scene.tracks)
    both = certain & scene.present[lines[of_line] // len(RELATIONS)] & scene.present[other]
    met, seen = _next(certain), _next(both)
    within = met <= until[of_line]
    people = np.zeros((len(lines), count), np.int64)
    np.add.at(people, of_line, within)
    reach = np.where(until == NOBODY, 0, scene.keyframes[until] - scene.keyframes)
    begins = (reach >= frames(rules.long_wait_s)) & (people >= rules.count_min)
    chosen_line, chosen_at = np.nonzero(begins)
    number = np.full(begins.shape, NOBODY)
    number[begins] = np.arange(len(chosen_line))
    row, place = np.nonzero(within & begins[of_line])
    order = np.lexsort((other[row], number[of_line[row], place]))
    row, place = row[order], place[order]
    first_seen = seen[row, place]
    return Company(
        moment=lines[chosen_line] // len(RELATIONS) * count + chosen_at,
        relation=lines[chosen_line] % len(RELATIONS),
        until=scene.keyframes[until[chosen_line, chosen_at]],
        owner=number[of_line[row], place],
        person=other[row],
        met=scene.keyframes[met[row, place]],
        seen=np.where(first_seen < count, scene.keyframes[np.minimum(first_seen, count - 1)], NOBODY),
    )


def _known_until(scene: Scene, facts: Facts, counted: Ints, lines: Ints, line: Ints) -> Ints:
    """(lines, keyframes): the last keyframe through which it is known from this one on who is met, or NOBODY."""
    count = len(scene.keyframes)
    kind = KIND[facts.relation[counted]]
    source, target = facts.source[counted], facts.target[counted]
    moments = (lines // len(RELATIONS))[:, None] * count + np.arange(count)
    # Of those of whom nothing is known, only the ones with a certain fact are known to be in the relation.
    untold = ~(facts.told[kind, source] & facts.told[kind, target])
    open_to = untold_others(scene, facts.told)[KIND[lines % len(RELATIONS)][:, None], moments]
    place = (line, source % count)
    np.subtract.at(open_to, place, untold)
    np.add.at(open_to, place, ~facts.certain[counted])
    known = (scene.moment_rows[moments] != NOBODY) & (open_to == 0)
    return np.where(known, _next(~known) - 1, NOBODY)


def _next(marks: Bools) -> Ints:
    """Per row and place the first place from there on that is marked; the number of places where there is none."""
    count = marks.shape[1]
    places = np.where(marks, np.arange(count), count)
    return np.minimum.accumulate(places[:, ::-1], axis=1)[:, ::-1]
