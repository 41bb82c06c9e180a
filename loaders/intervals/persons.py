"""What frames state of a person, and members of their group, counted: the majority is the attribute's value.

A frame votes where it states the attribute with difficulty 1 or 2 and a value that is not "cannot be told". Of a
person, a value is chosen that has more than half of all votes; of a group, every value that more than half of the
records with the attribute state, but a venue only if it is the only such one.

The interval tables `objects`, things with a track, which the panoptic layer shows or the reasoning layer names, and
`object_sightings`, their boxes. A thing is known by its track and its category together. People are left out: the box
layers count them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.intervals.people import HARD, UNREADABLE, Facts, read_groups
from jrdb_avr.loaders.intervals.timeline import Timeline
from jrdb_avr.loaders.labelfiles.columns import (
    ascending,
    begins,
    distinct_of,
    nullable,
    paired,
    rank_values,
    ranked,
    rows_of,
    texts,
    unpaired,
    whole_numbers,
)
from jrdb_avr.loaders.report import Disagreement
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.panorama import center_angle
from jrdb_avr.schema.things import PERSON_CATEGORIES

_TOPIC: Final = ["subject", "attribute"]


def demographics_table(line: Timeline, table: pa.Table) -> pa.Table:
    """The interval table `demographics`, from the annotation table of that name."""
    votes = person_votes(table)
    cast = votes.group_by(_TOPIC).aggregate([("votes", "sum")])
    chosen = pc.greater(pc.multiply(votes["votes"], 2), _of_topic(votes, cast, "votes_sum"))
    return line.table("demographics", _columns(votes, "track", chosen))


def group_info_table(line: Timeline, table: pa.Table, groups: Facts) -> pa.Table:
    """The interval table `group_info`, from the annotation table of that name."""
    votes = group_votes(table, groups)
    chosen = pc.greater(pc.multiply(votes["votes"], 2), votes["records"])
    rivals = votes.filter(chosen).group_by(_TOPIC).aggregate([("value", "count")])
    several = pc.fill_null(pc.greater(_of_topic(votes, rivals, "value_count"), 1), False)
    chosen = pc.and_not(chosen, pc.and_(pc.equal(votes["attribute"], "venue"), several))
    return line.table("group_info", _columns(votes, "cluster", chosen))


def chosen_values(demographics: pa.Table, attribute: str, tracks: Ints) -> pa.Array:
    """The value that all votes on a person state, null where there is none. `demographics` is the interval table."""
    rows = demographics.filter(pc.equal(demographics["attribute"], attribute))
    votes = rows.group_by("track").aggregate([("value", "count")])
    rows = rows.filter(pc.is_in(rows["track"], votes["track"].filter(pc.equal(votes["value_count"], 1))))
    values = rows["value"].to_pylist()
    return texts(values, rows_of(whole_numbers(rows, "track"), tracks))


def disagreements(tables: Mapping[str, pa.Table]) -> list[Disagreement]:
    """People whose frames, and groups whose members' records, state different values. `tables`: annotation tables."""
    found = _split(person_votes(tables["demographics"]), "person", alone=True)
    return found + _split(group_votes(tables["group_info"], read_groups(tables["groups"])), "group", alone=False)


def _split(votes: pa.Table, kind: str, alone: bool) -> list[Disagreement]:
    """Topics on which votes differ. `alone`: a topic has one value only, so two of them differ in any case."""
    found: dict[tuple[int, str], Disagreement] = {}
    for row in votes.to_pylist():
        subject, attribute, records = row["subject"], row["attribute"], row["records"]
        topic = found.setdefault((subject, attribute), Disagreement(f"{kind} {subject}", attribute, {}, records))
        topic.votes[row["value"]] = row["votes"]
    return [
        topic
        for topic in found.values()
        if (alone and len(topic.votes) > 1) or any(votes < topic.stated for votes in topic.votes.values())
    ]


def person_votes(table: pa.Table) -> pa.Table:
    """Votes of the annotation table `demographics` by track."""
    return _count(table, whole_numbers(table, "track"), np.ones(len(table), np.bool_))


def group_votes(table: pa.Table, groups: Facts) -> pa.Table:
    """Votes of the annotation table `group_info` by the cluster that a record names; one without cluster has none."""
    row = groups.rows(whole_numbers(table, "frame"), whole_numbers(table, "track"))
    return _count(table, np.append(groups.value, 0)[row], row >= 0)


def _count(table: pa.Table, subject: Ints, has: Bools) -> pa.Table:
    """Votes per subject, attribute and value, ascending. `records`: votes on the attribute, one per record.

    `subject` of each row, where it `has` one; the rows of a record stand together. Two spellings of one value in a
    record count as one vote.
    """
    attributes, attribute = ranked(table["attribute"])
    values, value = ranked(table["value"])
    subjects, number = rank_values(subject)
    record = np.cumsum(begins(whole_numbers(table, "frame"), whole_numbers(table, "track")))
    cast = has & (table["difficulty"].fill_null(UNREADABLE).to_numpy() < HARD) & (value >= 0)
    # As one number each: texts would take many times the time and memory.
    words, topics = max(len(values), 1), max(len(subjects) * len(attributes), 1)
    keys = ((record * topics + number * len(attributes) + attribute) * words + value)[cast]
    # They are nearly in order, which a stable sort is fast for.
    keys = distinct_of(np.sort(keys, kind="stable"))
    told, of_told = rank_values(distinct_of(keys // words) % topics)
    fact, of_fact = rank_values(keys % (topics * words))
    votes, records = np.bincount(of_fact), np.bincount(of_told)
    topic, value = np.divmod(fact, words)
    subject, attribute = np.divmod(topic, max(len(attributes), 1))
    columns = {"subject": subjects[subject], "attribute": texts(attributes, attribute), "value": texts(values, value)}
    return pa.table({**columns, "votes": votes, "records": records[np.searchsorted(told, topic)]})


def _of_topic(votes: pa.Table, topics: pa.Table, name: str) -> pa.ChunkedArray:
    """A column of a table of topics, for each row of votes."""
    keys = [pc.binary_join_element_wise(t["subject"].cast(pa.string()), t["attribute"], "/") for t in (votes, topics)]
    return topics[name].take(pc.index_in(keys[0], keys[1].combine_chunks()))


def _columns(votes: pa.Table, subject: str, chosen: pa.ChunkedArray) -> dict[str, pa.ChunkedArray]:
    return {subject: votes["subject"], "chosen": chosen, **{n: votes[n] for n in ("attribute", "value", "votes")}}


def objects_table(line: Timeline, panoptic: pa.Table, categories: pa.Table, handles: pa.Table) -> pa.Table:
    """From the annotation tables: one row per (category, thing), in this order."""
    seen = panoptic.select(["frame", "object", "category_id"]).drop_null()
    keys, frame = _keys(seen), whole_numbers(seen, "frame")
    order = ascending(keys, frame)
    keys, frame = keys[order], frame[order]
    things = distinct_of(np.sort(np.concatenate([keys, _keys(handles)])))
    things = things[~of_people(unpaired(things)[0], categories)]
    category, track = unpaired(things)
    names = dict(zip(*(categories[name].to_pylist() for name in ("category_id", "category")), strict=True))
    begin, end = np.searchsorted(keys, things), np.searchsorted(keys, things, "right")
    unseen: Bools = begin == end
    columns = {
        "object": track,
        "category_id": category,
        "category": pa.array([names.get(number) for number in category.tolist()], pa.string()),
        "first_frame": nullable(_at(frame, begin), unseen, pa.int32()),
        "last_frame": nullable(_at(frame, end - 1), unseen, pa.int32()),
    }
    return line.table("objects", columns)


def object_sightings_table(line: Timeline, panoptic: pa.Table, categories: pa.Table) -> pa.Table:
    """From the annotation tables: one row per box of a thing, by frame, category and thing."""
    seen = panoptic.drop_columns(["area", "segmentation"]).drop_null()
    seen = seen.filter(pa.array(~of_people(whole_numbers(seen, "category_id"), categories)))
    columns = {name: seen[name] for name in seen.column_names}
    return line.table("object_sightings", columns | {"angle": center_angle(seen["x"].to_numpy(), seen["w"].to_numpy())})


def of_people(category_id: Ints, categories: pa.Table) -> Bools:
    """Which numbers of categories are of people; `categories` is the annotation table."""
    people = pc.is_in(categories["category"], pa.array(sorted(PERSON_CATEGORIES)))
    return np.isin(category_id, categories["category_id"].filter(people).to_numpy())


def _keys(table: pa.Table) -> Ints:
    """One number per (category, thing)."""
    return paired(whole_numbers(table, "category_id"), whole_numbers(table, "object"))


def _at(values: Ints, place: Ints) -> Ints:
    """Values at places, of which some may lie outside."""
    return np.append(values, 0)[np.minimum(place, len(values))]
