"""Conversion of the annotation tables of one sequence into its interval tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import pyarrow as pa

from jrdb_avr.loaders.intervals.neighbors import beside_table
from jrdb_avr.loaders.intervals.people import read_people, track_spans, with_other_words
from jrdb_avr.loaders.intervals.persons import (
    chosen_values,
    demographics_table,
    group_info_table,
    object_sightings_table,
    objects_table,
)
from jrdb_avr.loaders.intervals.presence import absences_table, presences_table
from jrdb_avr.loaders.intervals.segments import segments_table
from jrdb_avr.loaders.intervals.sightings import sightings_table
from jrdb_avr.loaders.intervals.spans import handles_tables, interactions_tables, label_tables, layer_runs
from jrdb_avr.loaders.intervals.timeline import frames_table, sequence_table, timeline
from jrdb_avr.loaders.labelfiles.columns import distinct_of
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS

_LABELS: Final = {"actions": "action", "interactions": "label", "handles": "verb"}
"""Column of the label, by layer. A person with a label of these layers may also have the labels that `ALSO` names."""


def derive(sequence: str, annotations: Mapping[str, pa.Table], rules: LoadRules) -> dict[str, pa.Table]:
    """Derive the interval tables of one sequence. The result depends on the arguments only.

    Args:
        sequence: Name of the sequence.
        annotations: Annotation tables by name. A missing table counts as empty.
        rules: Thresholds.

    Returns:
        The interval tables, by name.
    """
    tables = {layer: annotations.get(layer, schema.empty_table()) for layer, schema in ANNOTATIONS.items()}
    tables |= {layer: with_other_words(tables[layer], column) for layer, column in _LABELS.items()}
    people = read_people(tables, rules)
    boxes = people.boxes
    line = timeline(sequence, tables["frames"], distinct_of(boxes.frame), tables["timestamps"])
    actions = layer_runs(line, "actions", people.actions, rules)
    groups = layer_runs(line, "groups", people.groups, rules)
    tracks, first, last = track_spans(tables)
    demographics = demographics_table(line, tables["demographics"])
    chosen = {name: chosen_values(demographics, name, tracks) for name in ("gender", "age", "ethnicity")}
    beside, views_listed = beside_table(line, boxes, people.located, rules)
    derived = {
        "sequence": sequence_table(line, boxes.source),
        "frames": frames_table(line),
        "persons": line.table("persons", {"track": tracks, **chosen, "first_frame": first, "last_frame": last}),
        "sightings": sightings_table(line, people, rules, views_listed),
        **label_tables(
            line, "actions", actions, {"track": actions.track, "action": actions.value}, people.actions.names
        ),
        **label_tables(line, "memberships", groups, {"track": groups.track, "cluster": groups.value}),
        "presences": presences_table(line, boxes),
        "absences": absences_table(line, boxes),
        "object_sightings": object_sightings_table(line, tables["panoptic"], tables["categories"]),
        "objects": objects_table(line, tables["panoptic"], tables["categories"], tables["handles"]),
        "demographics": demographics,
        "group_info": group_info_table(line, tables["group_info"], people.groups),
        **interactions_tables(line, tables["interactions"], boxes, rules),
        **handles_tables(line, tables["handles"], tables["categories"], boxes, rules),
        "beside": beside,
        "segments": segments_table(line, people, actions, rules),
    }
    return {kind: derived.get(kind, schema.empty_table()) for kind, schema in INTERVALS.items()}
