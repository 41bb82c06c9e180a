"""Arrow schemas of all Parquet tables, with the meaning of each column.

The names of tables and columns are a public interface. Annotation tables have the content of the label files: one row
per fact, with raw values. Interval tables are derived from the annotation tables under `LoadRules`, and can be built
again. Frames are the integer keys of the label files. Boxes are in pixels of the stitched panorama. 3D positions are in
metres in the robot frame (x forward, y left, z up). Intervals include their first and their last frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pyarrow as pa

_S = pa.string()
_I = pa.int32()
_F = pa.float64()
_B = pa.bool_()
_CODE = pa.int8()
_LONG = pa.int64()


def _list(item: pa.DataType, size: int = -1) -> pa.DataType:
    return pa.list_(pa.field("item", item, nullable=False), size)


LAYERS: Final = (
    *("2d", "actions", "groups", "3d", "demographics", "interactions", "group_info", "handles", "pose", "panoptic"),
    *("timestamps", "images"),
)
"""Values of the column `layer` in the table `frames`.

One label file may have several layers, and each layer may have labels at different frames. The file of 2D boxes also
has the layers `actions` and `groups`. The social file has `demographics`, `interactions` and `group_info`. If the
social file is missing, these three layers are read from the reasoning file. Only the reasoning file has `handles`.
"""

COLUMNS: Final[dict[str, tuple[pa.DataType, str]]] = {
    "sequence": (_S, "name of the sequence"),
    "layer": (_S, "annotation layer"),
    "frame": (_I, "frame index"),
    "track": (_I, "id of the person in the sequence"),
    "records": (_I, "number of records of the layer at the frame"),
    "x": (_F, "left edge, stitched pixels"),
    "y": (_F, "upper edge, stitched pixels"),
    "w": (_F, "width, stitched pixels"),
    "h": (_F, "height, stitched pixels"),
    "first": (_I, "first frame of the interval"),
    "last": (_I, "last frame of the interval, which belongs to it"),
    "first_s": (_F, "time of the first frame, seconds from frame 0"),
    "last_s": (_F, "time of the last frame, seconds from frame 0"),
    "certain": (_B, "true if the fact is beyond doubt, false if it is unknown"),
    "gap": (_B, "true if the interval is a short gap between labels; false if the words of another label may mean it"),
    "difficulty": (_CODE, "difficulty by the annotators: 1 easy, 2 medium, 3 hard; null if the code cannot be read"),
    "raw": (_S, "label as written in the file"),
    "cluster": (_LONG, "id of the group in the sequence"),
    "attribute": (_S, "name of the attribute"),
    "value": (_S, "value of the attribute; null if the annotators could not tell"),
    "votes": (_I, "number of frames that label the attribute with this value"),
    "chosen": (_B, "true if the value has more than half of the votes"),
    "source": (_I, "track of the person at the start of the relation"),
    "target": (_I, "track of the person at the end of the relation"),
    "partner": (_I, "track of the other person of the interaction"),
    "label": (_S, "name of the relation"),
    "verb": (_S, "verb that says how the person handles the thing"),
    "object": (_I, "track of the thing; each category has its own tracks"),
    "category_id": (_I, "id of the thing's category in the label file"),
    "category": (_S, "name of the category; null if it is unknown"),
    "action": (_S, "name of the action"),
    "pose": (_S, "pose, if exactly one is certain and the person is not covered; else null"),
    "posed": (_B, "true if the list tells exactly one certain pose, so that all other poses are false"),
    "seconds": (_F, "time of the frame after frame 0, or duration of the step or answer, in seconds"),
    "keyframe": (_B, "true if the frame is a keyframe of the sequence"),
    "annotated": (_B, "true if the 2D layer has the frame and its boxes show all people in view"),
    "image": (_B, "true if the frame has a panorama"),
    "angle": (_F, "panorama angle of the box's centre, degrees: 180 straight ahead, 90 to the left"),
    "sector": (_S, "side of the robot: ahead, left, right or behind; null between two sides"),
    "distance": (_F, "distance from the robot, metres"),
    "distance_word": (_S, "word for the distance; null if the distance is unknown"),
    "distance_word_other": (_S, "second possible word if the distance is near a bound; null if one word is certain"),
    "clear": (_B, "true if the box is a clear view under the load rules"),
    "covered": (_B, "true if the person is certainly not in clear view, and counts for nobody at the frame"),
    "visibility": (_S, "evidence for clear views: attributes, geometry (nearer boxes, group labels) or nothing"),
    "face_visible": (_B, "true if the head or an eye is marked as visible; null if there are no key points"),
    "listed": (_B, "true if the whole list of actions was read, so that an action without a label is false"),
    "interactions_listed": (_B, "true if the whole list was read, so that an interaction without a label is false"),
    "handles_listed": (_B, "true if the whole list was read, so that handling a thing without a label is false"),
    "robot_view_listed": (_B, "true unless `load` left out who is the first person to a side, for too many facts"),
    "person_view_listed": (_B, "true if the person is located, unless `load` left out all relative places"),
    "group_size": (_I, "number of people of the group in clear view, the person included; null if it is unknown"),
    "group_size_min": (_I, "minimum of `group_size`; null if the group is unknown or the person is covered"),
    "group_size_max": (_I, "maximum of `group_size`; null if the group is unknown or the person is covered"),
    "located": (_B, "true if the person has a 3D box with lidar points at the frame"),
    "heading": (_F, "direction that the person faces, radians in [-pi, pi) counter-clockwise from ahead of the robot"),
    "occlusion": (_S, "degree of occlusion, as annotated"),
    "no_eval": (_B, "true if the annotators excluded the box from evaluation"),
    "sensor": (_S, "name of the camera, or kind of sensor"),
    "timestamp": (_F, "seconds since the epoch"),
    "question_id": (_S, "id of the question"),
    "run_id": (_S, "id of the run"),
    "segmentation": (_S, "mask of the segment, as the run-length code in the file"),
    "keypoints": (_list(_F, 51), "17 times x and y (stitched pixels), visibility (0 hidden, 1 occluded, 2 visible)"),
    "gender": (_S, "gender, if all votes agree; else null"),
    "age": (_S, "age group, if all votes agree; else null"),
    "ethnicity": (_S, "ethnicity, if all votes agree; else null"),
    "has_attributes": (_B, "true if the record has attributes, such as the degree of occlusion"),
    "has_actions": (_B, "true if the record has a usable list of actions"),
    "truncated": (_B, "true if the person is cut off by the edge of the image, as annotated"),
    "interpolated": (_B, "true if the box was interpolated between two drawn boxes, as annotated"),
    "file_id": (_S, "id of the label in its file"),
    "activity": (_S, "name of the shared activity"),
    "cx": (_F, "centre of the 3D box, metres forward of the robot"),
    "cy": (_F, "centre of the 3D box, metres left of the robot"),
    "cz": (_F, "centre of the 3D box, metres up"),
    "l": (_F, "length of the 3D box, metres"),
    "rot_z": (_F, "rotation about the vertical axis, radians, as written in the file"),
    "num_points": (_I, "number of lidar points inside the 3D box"),
    "area": (_F, "area of the segment, pixels"),
    "width": (_I, "width of the image, pixels"),
    "height": (_I, "height of the image, pixels"),
    "fx": (_F, "horizontal focal length, pixels"),
    "fy": (_F, "vertical focal length, pixels"),
    "fps": (_F, "frames per second"),
    "frame_count": (_I, "number of frames of the sequence"),
    "layers": (_list(_S), "names of the annotation layers of the sequence"),
    "action_step": (_I, "number of frames from one action label to the next: 1, or 15 for one label per second"),
    "keyframes": (_list(_I), "frame indexes of the keyframes"),
    "frames": (_list(_I), "indexes of the frames that can be observed"),
    "first_frame": (_I, "first frame with a label of the person or thing"),
    "last_frame": (_I, "last frame with a label of the person or thing"),
    "start": (_I, "start that questions use: `first`, or half a second earlier if labels come once per second"),
    "end": (_I, "end that questions use: `last`, or half a second later if labels come once per second"),
    "quiet_from": (_I, "first frame of the time directly before the segment during which the action is false"),
    "closed": (_B, "true if, during a second after the end, the person is present and the action is false"),
    "family": (_S, "name of the family of templates"),
    "template": (_S, "name of the template"),
    "question": (_S, "text of the question"),
    "choices": (_list(_S), "texts of the four choices, in the order that answers count from 1; empty in other modes"),
    "answer_mode": (_S, "form of the answer: multiple_choice, frame, span, frame_viewpoint or number"),
    "answer": (_S, "true answer, as JSON"),
    "target_track": (_I, "track of the target, the person that the answer is about"),
    "plan": (_S, "plan of the question, as JSON (docs/plans.md)"),
    "proofs": (_S, "proofs with their results, as JSON; `holds` is null if the proof was not run"),
    "twin_id": (_S, "common key of two time twins, questions that differ in one asked time; null without a twin"),
    "rules": (_S, "hash of the rules under which the question was generated"),
    "hops": (_I, "number of relations in the plan; a fork-join has 4 here, but 2 in `stats` and `report`"),
    "time_gap_s": (_F, "time from the description to the last needed frame, seconds"),
    "separation_deg": (_F, "change of the target's angle from the description to the decisive frame, degrees"),
    "people_in_scene": (_I, "number of people with a box at the time of the description"),
    "bindings": (_S, "track or frame for each name in the plan, as JSON"),
    "needed": (_S, "boxes that a method must see, as JSON"),
    "kind": (_S, "model, observe, tool or solve"),
    "rule": (_S, "name of the rule that refused the candidates"),
    "candidates": (_LONG, "number of refused candidates"),
    "reviewer": (_S, "name of the reviewer"),
    "decision": (_S, "accept or reject"),
    "reason": (_S, "reason of the reviewer's decision, or why the model's output was refused; empty for none"),
    "method": (_S, "name of the method"),
    "model": (_S, "id of the model"),
    "synthetic": (_B, "true if a simulated model or the sample world was used: the scores do not describe JRDB"),
    "created": (_S, "start time of the run, ISO 8601"),
    "settings": (_S, "other settings of the run, as JSON"),
    "status": (_S, "answered; invalid if answer or box is missing because output could not be read; or error"),
    "verdict": (_S, "support of the world model: certain, supported or guess; null if the method has none"),
    "proposed": (_S, "answer that the model proposed last, as JSON; null without a proposal or a world model"),
    "evidence_frame": (_I, "frame of the evidence box"),
    "evidence_x": (_F, "left edge of the evidence box, stitched pixels"),
    "evidence_y": (_F, "upper edge of the evidence box, stitched pixels"),
    "evidence_w": (_F, "width of the evidence box, stitched pixels"),
    "evidence_h": (_F, "height of the evidence box, stitched pixels"),
    "n_observations": (_I, "number of crops and panoramas that the method looked at"),
    "n_model_calls": (_I, "number of model calls"),
    "prompt_tokens": (_LONG, "number of tokens sent to the model"),
    "completion_tokens": (_LONG, "number of tokens that the model wrote"),
    "step": (_I, "position of the step in the transcript of the question, from 0"),
    "tool": (_S, "name of the tool"),
    "arguments": (_S, "arguments of the tool, as JSON"),
    "accepted": (_B, "false if the write was refused, so that the world model did not change"),
    "fact": (_S, "rows that the write added to the world model, as JSON"),
    "request": (_S, "what was requested, without the bytes of images"),
    "response": (_S, "what was returned, without the bytes of images"),
    "answer_score": (_CODE, "1 if the answer is right, else 0"),
    "evidence_score": (_CODE, "1 if the evidence box is right, else 0"),
    "combined_score": (_CODE, "1 if both the answer and the evidence box are right, else 0"),
    "invalid": (_B, "true if the answer or the box is missing because the model's output could not be read"),
}
"""Type and meaning of each column, by its name. `SPECIAL` has the exceptions for single tables."""

SPECIAL: Final[dict[tuple[str, str], tuple[pa.DataType, str]]] = {
    ("annotations_social_activities", "value"): (_F, "number for the activity, as written; null if it is missing"),
    ("annotations_boxes_3d", "w"): (_F, "width of the 3D box, metres"),
    ("annotations_boxes_3d", "h"): (_F, "height of the 3D box, metres"),
    ("annotations_boxes_3d", "distance"): (_F, "distance from the robot, metres, as written in the file"),
    ("annotations_calibration", "cx"): (_F, "column of the principal point, pixels"),
    ("annotations_calibration", "cy"): (_F, "row of the principal point, pixels"),
    ("annotations_listed", "layer"): (_S, "layer of the list: interactions or handles"),
    ("predictions", "answer"): (_S, "answer of the method, as JSON; null if there is none"),
    ("predictions", "raw"): (_S, "last text that the model wrote"),
    ("world", "number"): (_I, "index of the write in its episode, from 0"),
    ("world", "step"): (_I, "index of the model call that made the write"),
    ("world", "reason"): (_S, "reason of the refusal, empty if the write was accepted"),
}
"""Type and meaning of a column in one table if they differ from `COLUMNS`, by the names of the table and the column."""


def column(view: str, name: str) -> tuple[pa.DataType, str]:
    """Return the type and the meaning of a column of a view."""
    return SPECIAL.get((view, name)) or COLUMNS[name]


ABOUT: Final[dict[str, str]] = {}
"""One sentence about the content of each view, by the name of the view. `_schemas` fills this dictionary."""


def _schema(view: str, columns: str) -> pa.Schema:
    """Return the schema of a view. `columns` lists column names. A column may be null if a `?` follows its name."""
    names = [(name.rstrip("?"), name.endswith("?")) for name in columns.split()]
    return pa.schema([pa.field(name, column(view, name)[0], nullable) for name, nullable in names])


def _schemas(prefix: str, tables: dict[str, tuple[str, str]]) -> dict[str, pa.Schema]:
    """Return the schemas of tables, by the name of the table. Add the sentence about each table to `ABOUT`."""
    ABOUT.update({prefix + table: about for table, (about, _) in tables.items()})
    return {table: _schema(prefix + table, columns) for table, (_, columns) in tables.items()}


_ANNOTATIONS: Final = {
    "frames": ("Annotated frames of each layer, including frames without records.", "sequence layer frame records"),
    "boxes_2d": (
        "Boxes of people in the stitched panorama, with attributes of each box.",
        "sequence frame track x y w h has_attributes occlusion? truncated? interpolated? no_eval? has_actions file_id?",
    ),
    # A label with an unreadable code (difficulty null) makes the action unknown, like a hard label.
    "actions": ("Action labels, one row per person, frame and action.", "sequence frame track action raw difficulty?"),
    "groups": ("Group of each person at each frame.", "sequence frame track cluster difficulty?"),
    "social_activities": ("Activities that a person shares with a group.", "sequence frame track activity value?"),
    "boxes_3d": (
        "3D boxes of people in the robot frame (x forward, y left, z up), in metres.",
        "sequence frame track cx cy cz l w h rot_z distance? num_points? interpolated? no_eval?",
    ),
    "demographics": ("Labels of gender, age and ethnicity.", "sequence frame track attribute value? raw difficulty?"),
    "interactions": ("Labels of interactions of two people.", "sequence frame track partner label raw difficulty?"),
    # `bpc` and `ssc` are the annotators' abbreviations: what the bodies are on, and the salient surroundings.
    "group_info": (
        "Attributes of a person's group, as labelled in that person's record: venue, aim, bpc, ssc, location, inter.",
        "sequence frame track attribute value? raw difficulty?",
    ),
    # The pair (object, category_id) identifies the thing in the table `panoptic`.
    "handles": ("Labels of people who handle things.", "sequence frame track object category_id verb raw difficulty?"),
    "listed": (
        "People and frames with a complete list of interactions or handled things. What the list lacks is false.",
        "sequence layer frame track",
    ),
    "poses": ("Key points of each person at each frame.", "sequence frame track keypoints"),
    # `object` is null for stuff, such as walls and sky, because stuff has no tracks.
    "panoptic": (
        "Segments of things (such as chairs) and stuff (such as walls), with masks in run-length code.",
        "sequence frame object? category_id x? y? w? h? area? segmentation?",
    ),
    # Each label file of the panoptic layer has its own ids of categories.
    "categories": ("Names of the category ids of a label file.", "sequence category_id category? raw"),
    "timestamps": ("Time of each frame, by camera or sensor.", "sequence sensor frame timestamp"),
    "calibration": ("Pinhole parameters of the cameras.", "sequence sensor width? height? fx fy cx cy"),
}
ANNOTATIONS: Final = _schemas("annotations_", _ANNOTATIONS)

_INTERVALS: Final = {
    "sequence": ("Facts about each sequence.", "sequence fps frame_count layers action_step keyframes visibility"),
    "frames": (
        "Annotated frames. `seconds` is computed from the timestamps if there are any, and otherwise from fps.",
        "sequence frame seconds keyframe annotated image",
    ),
    "persons": (
        "People, with the attributes on which all votes agree. Each frame with a label is a vote.",
        "sequence track gender? age? ethnicity? first_frame last_frame",
    ),
    "demographics": ("Votes for the attributes of each person.", "sequence track attribute value votes chosen"),
    "sightings": (
        "Boxes of people, with direction, distance, visibility, pose and group of the person at that frame.",
        "sequence frame track x y w h angle occlusion? no_eval clear covered face_visible? listed interactions_listed "
        "handles_listed pose? posed cluster? group_size? group_size_min? group_size_max? sector? located distance? "
        "distance_word? distance_word_other? cx? cy? cz? heading? robot_view_listed person_view_listed",
    ),
    "object_sightings": (
        "Boxes of things at the frames of the panoptic layer, with the direction of the box.",
        "sequence frame object category_id x y w h angle",
    ),
    "presences": (
        "Intervals with a box of a person; `certain` if the boxes are clear views.",
        "sequence track first last first_s last_s certain",
    ),
    "absences": (
        "Intervals without a box between two boxes of a person; `certain` if there is no box within a second either.",
        "sequence track first last first_s last_s certain",
    ),
    # `certain` is false for hard and unreadable labels, and for two poses at the same time.
    "actions": (
        "Action labels, joined to intervals.",
        "sequence track action first last first_s last_s difficulty? certain",
    ),
    "memberships": ("Group labels, joined to intervals.", "sequence track cluster first last first_s last_s certain"),
    # If one person's record states an interaction, it holds for both people. So both directions have rows.
    "interactions": (
        "Interaction labels, joined to intervals. Each interaction has a row for each of the two people as the source.",
        "sequence source target label first last first_s last_s certain",
    ),
    "handles": (
        "Labels of people who handle things, joined to intervals.",
        "sequence track object category_id verb first last first_s last_s certain",
    ),
    "objects": (
        "Things that have a track. `category` is null if the panoptic layer does not have the thing or its category.",
        "sequence object category_id category? first_frame? last_frame?",
    ),
    "group_info": ("Votes for the attributes of each group.", "sequence cluster attribute value votes chosen"),
    # A relation in the robot's view has one row per keyframe. An uncertain relation may have several targets.
    "beside": (
        "Place of the target seen from the source ('left, close'), or the first person to a side in the robot's view.",
        "sequence source target label first last first_s last_s certain",
    ),
    "segments": ("Stable segments of all actions.", "sequence track action first last start end quiet_from closed"),
}
LABELED: Final = ("actions", "memberships", "interactions", "handles")
"""Interval tables of labels. Each has a companion table `possible_<name>` of facts without a label that may be true."""

_POSSIBLE: Final = {
    f"possible_{name}": (
        f"Facts of the kinds in `intervals_{name}` that no label states but that may be true.",
        _INTERVALS[name][1].replace("difficulty? ", "").replace("certain", "gap"),
    )
    for name in LABELED
}
INTERVALS: Final = _schemas("intervals_", _INTERVALS | _POSSIBLE)

_QUESTIONS: Final = {
    "questions": ("Questions, without answers.", "question_id sequence family template question choices answer_mode"),
    "sequences": ("Sequences, with the frames that can be observed.", "sequence fps frame_count frames"),
    "answers": (
        "Answer, target, plan and proofs of each question.",
        "question_id answer target_track plan proofs rules hops time_gap_s separation_deg "
        "people_in_scene bindings needed twin_id?",
    ),
    "evidence": (
        "Boxes of all targets at all frames. Join them by `sequence` and `track` = `answers.target_track`.",
        "sequence track frame x y w h",
    ),
    "rejected": (
        "Number of refused candidates by sequence, template and rule.",
        "sequence family template rule candidates",
    ),
    "reviews": ("Decisions of reviewers to accept or reject a question.", "question_id reviewer decision reason"),
}
QUESTIONS: Final = _schemas("", _QUESTIONS)

_RUNS: Final = {
    "runs": ("Runs, as described by their `run.json`.", "run_id method model synthetic created settings"),
    "predictions": (
        "Predictions of the runs: the answer and the evidence box of each question, with costs.",
        "run_id question_id status answer? evidence_frame? evidence_x? evidence_y? evidence_w? evidence_h? raw "
        "reason verdict? proposed? n_observations n_model_calls prompt_tokens completion_tokens seconds",
    ),
    "steps": ("Transcripts: model calls, looks and so on.", "run_id question_id step kind request response seconds"),
    "world": (
        "Writes of agents into their world models, accepted or refused, in order.",
        "run_id question_id number step tool arguments accepted reason fact",
    ),
    "scores": ("Scores of each question.", "run_id question_id answer_score evidence_score combined_score invalid"),
}
RUNS: Final = _schemas("", _RUNS)

PRIVATE: Final = ("answers", "evidence", "rejected", "reviews")
"""Tables of `questions/` with answers. The process that talks to a model never opens them."""

CANARY: Final = "jrdb-avr benchmark data must not be trained on; canary 4c1f0c0e-2f0b-4f0e-9f44-8e2a6a1d7b35"
"""Text under the key `canary` in the metadata of every released file."""

GENERATION_KEY: Final = "generation"
"""Metadata key of the id that all tables of one generation share."""


def views() -> Iterator[tuple[str, pa.Schema, bool]]:
    """Yield the name and the schema of each view, and whether the view is private."""
    for prefix, group in (("annotations_", ANNOTATIONS), ("intervals_", INTERVALS), ("", QUESTIONS), ("", RUNS)):
        for name, schema in group.items():
            yield f"{prefix}{name}", schema, group is QUESTIONS and name in PRIVATE
