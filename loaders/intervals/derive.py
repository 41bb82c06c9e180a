"""Annotation tables of one sequence -> its interval tables: a pure function of tables and rules."""

from __future__ import annotations

from collections.abc import Mapping

import pyarrow as pa

from jrdb_avr.loaders.intervals.neighbors import beside_table
from jrdb_avr.loaders.intervals.people import (
    listed_keys,
    read_boxes,
    read_faces,
    read_groups,
    read_labels,
    read_located,
    track_spans,
)
from jrdb_avr.loaders.intervals.persons import chosen_values, demographics_table, group_info_table, objects_table
from jrdb_avr.loaders.intervals.segments import segments_table
from jrdb_avr.loaders.intervals.sightings import sightings_table
from jrdb_avr.loaders.intervals.spans import (
    action_runs,
    actions_table,
    handles_table,
    interactions_table,
    memberships_table,
)
from jrdb_avr.loaders.intervals.timeline import frames_table, sequence_table, timeline
from jrdb_avr.loaders.labelfiles.columns import constant, distinct_of
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS


def derive(sequence: str, annotations: Mapping[str, pa.Table], rules: LoadRules) -> dict[str, pa.Table]:
    """Interval tables by kind. Layers that `annotations` lacks count as empty."""
    tables = {layer: annotations.get(layer, schema.empty_table()) for layer, schema in ANNOTATIONS.items()}
    boxes = read_boxes(tables["boxes_2d"], rules)
    labels = read_labels(tables["actions"])
    groups = read_groups(tables["groups"])
    located = read_located(tables["boxes_3d"])
    line = timeline(sequence, tables["frames"], distinct_of(boxes.frame), tables["timestamps"])
    runs = action_runs(line, labels, rules)
    tracks, first, last = track_spans(tables)
    demographics = demographics_table(sequence, tables["demographics"])
    persons = {
        "sequence": constant(sequence, len(tracks)),
        "track": tracks,
        **{name: chosen_values(demographics, name, tracks) for name in ("gender", "age", "ethnicity")},
        "first_frame": first,
        "last_frame": last,
    }
    faces = read_faces(tables["poses"])
    listed = listed_keys(tables["listed"])
    derived = {
        "sequence": sequence_table(line, boxes.has_attributes),
        "frames": frames_table(line),
        "persons": pa.table(persons).cast(INTERVALS["persons"]),
        "sightings": sightings_table(line, boxes, labels, groups, located, listed, faces, rules),
        "actions": actions_table(line, labels, runs),
        "memberships": memberships_table(line, groups, rules),
        "objects": objects_table(sequence, tables["panoptic"], tables["categories"], tables["handles"]),
        "demographics": demographics,
        "group_info": group_info_table(sequence, tables["group_info"], groups),
        "interactions": interactions_table(line, tables["interactions"], boxes, rules),
        "handles": handles_table(line, tables["handles"], tables["categories"], boxes, rules),
        "beside": beside_table(line, boxes, located, rules),
        "segments": segments_table(line, boxes, labels, runs, rules),
    }
    return {kind: derived.get(kind, schema.empty_table()) for kind, schema in INTERVALS.items()}
