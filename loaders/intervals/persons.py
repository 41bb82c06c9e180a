"""What frames say of a person, and members of their group, counted: the majority is the attribute's value.

A frame votes where it tells the attribute with difficulty 1 or 2 and a value that is not "cannot be told". Of a person,
a value is chosen that has more than half of all votes; of a group, every value that more than half of the records
telling the attribute say, but a venue only if it is the only such one.

The interval table `objects`: things with a track, shown by the panoptic layer or named by the reasoning layer.

A thing is known by its track and its category together. People are left out: the box layers count them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.intervals.people import HARD, UNREADABLE, Groups, read_groups, rows_of
from jrdb_avr.loaders.labelfiles.columns import (
    begins,
    constant,
    distinct_of,
    nullable,
    paired,
    person_keys,
    ranked,
    texts,
    unpaired,
    whole_numbers,
)
from jrdb_avr.loaders.report import Disagreement
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.tables import INTERVALS
from jrdb_avr.schema.things import PERSON_CATEGORIES


@dataclass(frozen=True)
class Votes:
    """Votes per (subject, attribute, value), ascending. `tellers`: votes cast on the attribute, one per record."""

    subject: Ints
    attribute: list[str]
    value: list[str]
    votes: Ints
    tellers: Ints
    topic: Ints
    """A number per (subject, attribute), ascending."""

    def table(self, kind: str, subject: str, sequence: str, chosen: Bools) -> pa.Table:
        columns = {
            "sequence": constant(sequence, len(self.subject)),
            subject: self.subject,
            "attribute": pa.array(self.attribute, pa.string()),
            "value": pa.array(self.value, pa.string()),
            "votes": self.votes,
            "chosen": chosen,
        }
        return pa.table(columns).cast(INTERVALS[kind])


def demographics_table(sequence: str, table: pa.Table) -> pa.Table:
    """The interval table `demographics`, from the annotation table of that name."""
    votes = person_votes(table)
    cast = np.bincount(votes.topic, weights=votes.votes)[votes.topic]
    return votes.table("demographics", "track", sequence, 2 * votes.votes > cast)


def group_info_table(sequence: str, table: pa.Table, groups: Groups) -> pa.Table:
    """The interval table `group_info`, from the annotation table of that name."""
    votes = group_votes(table, groups)
    chosen = 2 * votes.votes > votes.tellers
    rivals = np.bincount(votes.topic, weights=chosen)[votes.topic] > 1
    venue = np.array([name == "venue" for name in votes.attribute], np.bool_)
    return votes.table("group_info", "cluster", sequence, chosen & ~(venue & rivals))


def chosen_values(demographics: pa.Table, attribute: str, tracks: Ints) -> pa.Array:
    """The chosen value of each person, null where there is none. `demographics` is the interval table."""
    rows = demographics.filter(pc.and_(demographics["chosen"], pc.equal(demographics["attribute"], attribute)))
    values = rows["value"].to_pylist()
    return texts(values, rows_of(whole_numbers(rows, "track"), tracks))


def disagreements(tables: Mapping[str, pa.Table]) -> list[Disagreement]:
    """People whose frames, and groups whose members' records, say different values. `tables` are annotation tables."""
    found = _split(person_votes(tables["demographics"]), "person", alone=True)
    return found + _split(group_votes(tables["group_info"], read_groups(tables["groups"])), "group", alone=False)


def _split(votes: Votes, subject: str, alone: bool) -> list[Disagreement]:
    """Topics on which votes differ. `alone`: a topic has one value only, so two of them differ in any case."""
    several = np.bincount(votes.topic)[votes.topic] > 1 if alone else np.zeros(len(votes.topic), np.bool_)
    found: dict[int, Disagreement] = {}
    differing = np.isin(votes.topic, votes.topic[several | (votes.votes < votes.tellers)])
    for row in np.flatnonzero(differing).tolist():
        name = f"{subject} {int(votes.subject[row])}"
        topic = found.setdefault(
            int(votes.topic[row]), Disagreement(name, votes.attribute[row], {}, int(votes.tellers[row]))
        )
        topic.votes[votes.value[row]] = int(votes.votes[row])
    return list(found.values())


def person_votes(table: pa.Table) -> Votes:
    """Votes of the annotation table `demographics` by track."""
    return _count(table, lambda frame, track: (track, np.ones(len(track), np.bool_)))


def group_votes(table: pa.Table, groups: Groups) -> Votes:
    """Votes of the annotation table `group_info` by the cluster that a record names; one without cluster has none."""
    keys = person_keys(groups.frame, groups.track)

    def cluster_of(frame: Ints, track: Ints) -> tuple[Ints, Bools]:
        row = rows_of(keys, person_keys(frame, track))
        return np.append(groups.cluster, 0)[row], row >= 0

    return _count(table, cluster_of)


def _count(table: pa.Table, subject_of: Callable[[Ints, Ints], tuple[Ints, Bools]]) -> Votes:
    """Count an annotation table sorted by (frame, track). `subject_of`: subjects of records, and which have one."""
    attributes, attribute = ranked(table["attribute"])
    values, value = ranked(table["value"])
    difficulty = table["difficulty"].fill_null(UNREADABLE).to_numpy()
    frame, track = whole_numbers(table, "frame"), whole_numbers(table, "track")
    new = begins(frame, track)
    record = np.cumsum(new) - 1
    subject, has = subject_of(frame[new], track[new])
    subjects, number = np.unique(subject, return_inverse=True)
    votes = np.flatnonzero((difficulty < HARD) & (value >= 0) & (has[record] if len(record) else new))
    record, attribute, value = record[votes], attribute[votes], value[votes]
    # Two spellings of one value in a record count as one vote.
    words, topics = len(attributes) * len(values) + 1, len(attributes) + 1
    record, word = np.divmod(distinct_of(np.sort(record * words + attribute * len(values) + value)), words)
    attribute = word // max(len(values), 1)
    told, tellers = _tally(number, *np.divmod(distinct_of(record * topics + attribute), topics), topics)
    voted, votes = _tally(number, record, word, words)
    number, word = np.divmod(voted, words)
    attribute, value = np.divmod(word, max(len(values), 1))
    topic = np.searchsorted(told, number * topics + attribute)
    return Votes(
        subjects[number],
        [attributes[i] for i in attribute.tolist()],
        [values[i] for i in value.tolist()],
        votes,
        tellers[topic],
        topic,
    )


def _tally(number: Ints, record: Ints, code: Ints, codes: int) -> tuple[Ints, Ints]:
    """How many records of a subject have a code: ascending keys `number * codes + code`, and their counts."""
    keys = np.sort(number[record] * codes + code)
    found = distinct_of(keys)
    return found, np.diff(np.searchsorted(keys, found), append=len(keys))


def objects_table(sequence: str, panoptic: pa.Table, categories: pa.Table, handles: pa.Table) -> pa.Table:
    """From the annotation tables: one row per (category, thing), in this order."""
    seen = panoptic.filter(pc.is_valid(panoptic["object"]))
    keys, frame = _keys(seen), whole_numbers(seen, "frame")
    order = np.lexsort((frame, keys))
    keys, frame = keys[order], frame[order]
    things = distinct_of(np.sort(np.concatenate([keys, _keys(handles)])))
    names = dict(zip(*(categories[name].to_pylist() for name in ("category_id", "category")), strict=True))
    people = [number for number, name in names.items() if name in PERSON_CATEGORIES]
    things = things[~np.isin(unpaired(things)[0], people)]
    category, track = unpaired(things)
    begin, end = np.searchsorted(keys, things), np.searchsorted(keys, things, "right")
    unseen: Bools = begin == end
    return pa.table(
        {
            "sequence": constant(sequence, len(things)),
            "object": track,
            "category_id": category,
            "category": pa.array([names.get(number) for number in category.tolist()], pa.string()),
            "first_frame": nullable(_at(frame, begin), unseen, pa.int32()),
            "last_frame": nullable(_at(frame, end - 1), unseen, pa.int32()),
        }
    ).cast(INTERVALS["objects"])


def _keys(table: pa.Table) -> Ints:
    """One number per (category, thing)."""
    return paired(whole_numbers(table, "category_id"), whole_numbers(table, "object"))


def _at(values: Ints, place: Ints) -> Ints:
    """Values at places, of which some may lie outside."""
    return values[np.clip(place, 0, len(values) - 1)] if len(values) else np.zeros(len(place), np.int64)
