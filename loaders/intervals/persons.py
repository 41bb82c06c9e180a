"""Attributes of people and groups by majority, and the things of a sequence.

A frame votes for a value if it states the value with difficulty 1 or 2. An undecided label is not a vote. A person has
the value that got more than half of the person's votes. A group has every value that is in more than half of the
group's records with the attribute. A group has a venue only if there is exactly one such venue.

The interval table `objects` has the things with a track in the panoptic or the reasoning layer. The interval table
`object_sightings` has the boxes of the things. The track and the category together identify a thing. People are left
out, because other tables have them.
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
    """Derive the interval table `demographics`.

    Args:
        line: Frames of the sequence.
        table: Annotation table `demographics`.
    """
    votes = person_votes(table)
    cast = votes.group_by(_TOPIC).aggregate([("votes", "sum")])
    chosen = pc.greater(pc.multiply(votes["votes"], 2), _of_topic(votes, cast, "votes_sum"))
    return line.table("demographics", _columns(votes, "track", chosen))


def group_info_table(line: Timeline, table: pa.Table, groups: Facts) -> pa.Table:
    """Derive the interval table `group_info`.

    Args:
        line: Frames of the sequence.
        table: Annotation table `group_info`.
        groups: Group labels.
    """
    votes = group_votes(table, groups)
    chosen = pc.greater(pc.multiply(votes["votes"], 2), votes["records"])
    rivals = votes.filter(chosen).group_by(_TOPIC).aggregate([("value", "count")])
    several = pc.fill_null(pc.greater(_of_topic(votes, rivals, "value_count"), 1), False)
    chosen = pc.and_not(chosen, pc.and_(pc.equal(votes["attribute"], "venue"), several))
    return line.table("group_info", _columns(votes, "cluster", chosen))


def chosen_values(demographics: pa.Table, attribute: str, tracks: Ints) -> pa.Array:
    """Return for each track the value of an attribute that all votes state, or null if there is none.

    Args:
        demographics: Interval table `demographics`.
        attribute: Name of the attribute.
        tracks: Tracks.
    """
    rows = demographics.filter(pc.equal(demographics["attribute"], attribute))
    votes = rows.group_by("track").aggregate([("value", "count")])
    rows = rows.filter(pc.is_in(rows["track"], votes["track"].filter(pc.equal(votes["value_count"], 1))))
    values = rows["value"].to_pylist()
    return texts(values, rows_of(whole_numbers(rows, "track"), tracks))


def disagreements(tables: Mapping[str, pa.Table]) -> list[Disagreement]:
    """Find the attributes with different values.

    Args:
        tables: Annotation tables by name.

    Returns:
        The attributes of people that differ between frames, and those of groups that differ between records.
    """
    people = _split(person_votes(tables["demographics"]), "person", alone=True)
    return people + _split(group_votes(tables["group_info"], read_groups(tables["groups"])), "group", alone=False)


def _split(votes: pa.Table, kind: str, alone: bool) -> list[Disagreement]:
    """Return the topics with different votes.

    If `alone` is true, every topic has only one value, so two votes differ.
    """
    topics: dict[tuple[int, str], Disagreement] = {}
    for row in votes.to_pylist():
        subject, attribute, records = row["subject"], row["attribute"], row["records"]
        topic = topics.setdefault((subject, attribute), Disagreement(f"{kind} {subject}", attribute, {}, records))
        topic.votes[row["value"]] = row["votes"]
    return [
        topic
        for topic in topics.values()
        if (alone and len(topic.votes) > 1) or any(votes < topic.stated for votes in topic.votes.values())
    ]


def person_votes(table: pa.Table) -> pa.Table:
    """Count the votes for the attributes of each track.

    Args:
        table: Annotation table `demographics`.
    """
    return _count(table, whole_numbers(table, "track"), np.ones(len(table), np.bool_))


def group_votes(table: pa.Table, groups: Facts) -> pa.Table:
    """Count the votes for the attributes of each cluster. A record without a cluster does not vote.

    Args:
        table: Annotation table `group_info`.
        groups: Group labels.
    """
    row = groups.rows(whole_numbers(table, "frame"), whole_numbers(table, "track"))
    return _count(table, np.append(groups.value, 0)[row], row >= 0)


def _count(table: pa.Table, subject: Ints, has: Bools) -> pa.Table:
    """Count the votes for each subject, attribute and value, sorted by these three.

    `subject` has the subject of each row, and `has` is the mask of the rows with a subject. The rows of a record are
    neighbours. If a record has two spellings of a value, it votes only once. The column `records` has the number of
    records that vote for the attribute.
    """
    attributes, attribute = ranked(table["attribute"])
    values, value = ranked(table["value"])
    subjects, subject_rank = rank_values(subject)
    record = np.cumsum(begins(whole_numbers(table, "frame"), whole_numbers(table, "track")))
    cast = has & (table["difficulty"].fill_null(UNREADABLE).to_numpy() < HARD) & (value >= 0)
    # Each vote is one number, because strings would take many times the time and memory.
    size, topics = max(len(values), 1), max(len(subjects) * len(attributes), 1)
    keys = ((record * topics + subject_rank * len(attributes) + attribute) * size + value)[cast]
    # A stable sort is fast, because the numbers are nearly sorted.
    keys = distinct_of(np.sort(keys, kind="stable"))
    topic_of, of_topic = rank_values(distinct_of(keys // size) % topics)
    fact, of_fact = rank_values(keys % (topics * size))
    votes, records = np.bincount(of_fact), np.bincount(of_topic)
    topic, value = np.divmod(fact, size)
    subject, attribute = np.divmod(topic, max(len(attributes), 1))
    columns = {"subject": subjects[subject], "attribute": texts(attributes, attribute), "value": texts(values, value)}
    return pa.table({**columns, "votes": votes, "records": records[np.searchsorted(topic_of, topic)]})


def _of_topic(votes: pa.Table, topics: pa.Table, name: str) -> pa.ChunkedArray:
    """Return a column of a table of topics, with one element for each row of `votes`."""
    keys = [pc.binary_join_element_wise(t["subject"].cast(pa.string()), t["attribute"], "/") for t in (votes, topics)]
    return topics[name].take(pc.index_in(keys[0], keys[1].combine_chunks()))


def _columns(votes: pa.Table, subject: str, chosen: pa.ChunkedArray) -> dict[str, pa.ChunkedArray]:
    return {subject: votes["subject"], "chosen": chosen, **{n: votes[n] for n in ("attribute", "value", "votes")}}


def objects_table(line: Timeline, panoptic: pa.Table, categories: pa.Table, handles: pa.Table) -> pa.Table:
    """Derive the interval table `objects`, which has one row per thing, sorted by category and track.

    Args:
        line: Frames of the sequence.
        panoptic: Annotation table `panoptic`.
        categories: Annotation table `categories`.
        handles: Annotation table `handles`.
    """
    boxed = panoptic.select(["frame", "object", "category_id"]).drop_null()
    keys, frame = _keys(boxed), whole_numbers(boxed, "frame")
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
        "category": pa.array([names.get(category_id) for category_id in category.tolist()], pa.string()),
        "first_frame": nullable(_at(frame, begin), unseen, pa.int32()),
        "last_frame": nullable(_at(frame, end - 1), unseen, pa.int32()),
    }
    return line.table("objects", columns)


def object_sightings_table(line: Timeline, panoptic: pa.Table, categories: pa.Table) -> pa.Table:
    """Derive the interval table `object_sightings`, which has one row per box, sorted by frame, category and track.

    Args:
        line: Frames of the sequence.
        panoptic: Annotation table `panoptic`.
        categories: Annotation table `categories`.
    """
    rows = panoptic.drop_columns(["area", "segmentation"]).drop_null()
    rows = rows.filter(pa.array(~of_people(whole_numbers(rows, "category_id"), categories)))
    columns = {name: rows[name] for name in rows.column_names}
    return line.table("object_sightings", columns | {"angle": center_angle(rows["x"].to_numpy(), rows["w"].to_numpy())})


def of_people(category_id: Ints, categories: pa.Table) -> Bools:
    """Return the mask of the ids that are of categories of people.

    Args:
        category_id: Ids of categories.
        categories: Annotation table `categories`.
    """
    people = pc.is_in(categories["category"], pa.array(sorted(PERSON_CATEGORIES)))
    return np.isin(category_id, categories["category_id"].filter(people).to_numpy())


def _keys(table: pa.Table) -> Ints:
    """Return one number per row. Equal numbers mean the same category and track."""
    return paired(whole_numbers(table, "category_id"), whole_numbers(table, "object"))


def _at(values: Ints, index: Ints) -> Ints:
    """Return the values at indices, and 0 for an index outside of `values`."""
    return np.append(values, 0)[np.minimum(index, len(values))]
