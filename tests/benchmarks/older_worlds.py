"""The record of a run that is long over, as large as is asked for: what a world model is measured over."""

import msgspec
import pyarrow as pa

from jrdb_avr.schema.beliefs import (
    AttributeRow,
    EntityRow,
    EpisodeRow,
    Fact,
    ObservationRow,
    RelationRow,
    SightingRow,
    episode_key,
)
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.tables import RUNS

PER_EPISODE = 10
READ = (1, 0, "model")
"""Votes for and against, and the origin."""


def older_record(entities, run="older"):
    """Episodes of ten entities each, with a sighting, three attributes and a relation of every entity."""
    rows = []
    for number in range(entities // PER_EPISODE):
        question = f"{number:016x}"
        for at, fact in enumerate(_facts(episode_key(run, question), run, question)):
            told = {"number": at, "step": at, "tool": "add_attribute", "arguments": "{}", "accepted": True}
            text = msgspec.json.encode(fact).decode()
            rows.append({"run_id": run, "question_id": question, **told, "reason": "", "fact": text})
    return pa.Table.from_pylist(rows, RUNS["world"])


def _facts(key, run, question):
    yield Fact(episode=EpisodeRow(key, run, question, "s", "", ""))
    seen = ObservationRow(f"{key}/o1", key, 1, 1, 15, 180.0, 1640, 480)
    yield Fact(observation=seen)
    number, before = 2, ""
    for n in range(PER_EPISODE):
        entity = EntityRow(f"{key}/p{n}", key, f"p{n}", n + 1, "person", "", number)
        sighted = SightingRow(entity.id, seen.id, key, number, number, *READ, 15, Box(1.0, 2.0, 3.0, 4.0), 180.0)
        yield Fact(entity=entity, sighted=sighted)
        number += 1
        for name, value in (("gender", "female"), ("action", "sitting"), ("sector", "front")):
            yield Fact(has=AttributeRow(entity.id, seen.id, key, number, number, *READ, name, value, 0.0, 15, 15))
            number += 1
        if before:
            yield Fact(
                related=RelationRow(entity.id, before, key, number, number, *READ, "conversation", seen.id, 15, 15)
            )
            number += 1
        before = entity.id
