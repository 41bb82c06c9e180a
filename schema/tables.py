"""Arrow schemas of all Parquet tables, with the meaning of each column. Names are part of the public interface.

Annotation tables hold the content of the files: one row per fact, with raw values. Interval tables are derived from
them under `LoadRules` and can be rebuilt. Frames are integer label keys. Boxes are in stitched pixels. 3D positions are
in metres in the robot frame (x forward, y left, z up). Intervals include both ends.
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
"""Layers of the `frames` table. One file may hold several layers with different steps: the 2D boxes have `actions` and
`groups`; the social file (the reasoning file if it is missing) has `demographics`, `interactions` and `group_info`; the
reasoning file has `handles`."""

COLUMNS: Final[dict[str, tuple[pa.DataType, str]]] = {
    "sequence": (_S, "name of the sequence"),
    "layer": (_S, "layer of labels"),
    "frame": (_I, "frame number"),
    "track": (_I, "number of the person in the sequence"),
    "records": (_I, "number of records of the layer at the frame"),
    "x": (_F, "left edge, stitched pixels"),
    "y": (_F, "upper edge, stitched pixels"),
    "w": (_F, "width"),
    "h": (_F, "height"),
    "first": (_I, "first frame, inclusive"),
    "last": (_I, "last frame, inclusive"),
    "first_s": (_F, "seconds of the first frame"),
    "last_s": (_F, "seconds of the last frame"),
    "certain": (_B, "false: the fact is unknown"),
    "gap": (_B, "true: a short gap between two labels; false: the words of another label may mean this"),
    "difficulty": (_CODE, "annotators' code: 1 easy, 2 medium, 3 hard, null unreadable"),
    "raw": (_S, "the label as written"),
    "cluster": (_LONG, "number of the group"),
    "attribute": (_S, "name of the attribute"),
    "value": (_S, "value of the attribute, null if annotators could not tell"),
    "votes": (_I, "number of frames with this value"),
    "chosen": (_B, "the value has more than half of the votes"),
    "source": (_I, "the person that the relation starts from"),
    "target": (_I, "the other person"),
    "partner": (_I, "the other person"),
    "label": (_S, "the relation"),
    "verb": (_S, "verb of handling the thing"),
    "object": (_I, "track of the thing, within its category"),
    "category_id": (_I, "number of the thing's category in its file"),
    "category": (_S, "name of the category, null if unknown"),
    "action": (_S, "name of the action"),
    "pose": (_S, "the one certain pose, null if unknown"),
    "seconds": (_F, "time from frame 0, or duration, in seconds"),
    "keyframe": (_B, "the frame is a keyframe of the sequence"),
    "annotated": (_B, "the 2D layer has the frame, and its boxes are all people in view"),
    "image": (_B, "the frame has a panorama"),
    "angle": (_F, "panorama angle, degrees: 180 ahead, 90 left"),
    "sector": (_S, "direction seen from the robot, null between two sectors"),
    "distance": (_F, "metres from the robot"),
    "distance_word": (_S, "the distance as a word, null if unknown"),
    "distance_word_other": (_S, "the second possible word near a bound, null if the first is certain"),
    "clear": (_B, "the box is a clear view under the rules"),
    "face_visible": (_B, "the head or an eye is marked visible, null without key points"),
    "listed": (_B, "the person has an action list at the frame, so an action without a label is false"),
    "interactions_listed": (_B, "the whole interaction list was read, so an interaction without a label is false"),
    "handles_listed": (_B, "the whole list of handled things was read, so handling without a label is false"),
    "group_size": (_I, "people in the group, null if unknown"),
    "located": (_B, "the person has a 3D box with lidar points at the frame"),
    "heading": (_F, "heading of the person, radians from straight ahead of the robot, counter-clockwise"),
    "occlusion": (_S, "degree of occlusion, as annotated"),
    "no_eval": (_B, "annotators excluded the box from evaluation"),
    "sensor": (_S, "camera or kind of sensor"),
    "timestamp": (_F, "seconds since the epoch"),
    "question_id": (_S, "id of the question"),
    "run_id": (_S, "id of the run"),
    "segmentation": (_S, "run-length code as written"),
    "keypoints": (_list(_F, 51), "17 times x, y (stitched pixels), visibility (0 not visible, 1 occluded, 2 visible)"),
    "gender": (_S, "the gender if all votes agree, else null"),
    "age": (_S, "the age group if all votes agree, else null"),
    "ethnicity": (_S, "the ethnicity if all votes agree, else null"),
    "has_attributes": (_B, "the record has attributes"),
    "has_actions": (_B, "the record has a usable action list"),
    "truncated": (_B, "cut off by the image, as annotated"),
    "interpolated": (_B, "filled in between two annotated boxes, as annotated"),
    "file_id": (_S, "identifier of the label in its file"),
    "activity": (_S, "the shared activity"),
    "cx": (_F, "centre, metres forward of the robot"),
    "cy": (_F, "centre, metres left of the robot"),
    "cz": (_F, "centre, metres up"),
    "l": (_F, "length, metres"),
    "rot_z": (_F, "rotation about the vertical axis as written, radians"),
    "num_points": (_I, "lidar points inside"),
    "area": (_F, "area of the segment, pixels"),
    "width": (_I, "width of the image, pixels"),
    "height": (_I, "height of the image, pixels"),
    "fx": (_F, "focal length across, pixels"),
    "fy": (_F, "focal length down, pixels"),
    "fps": (_F, "frames per second"),
    "frame_count": (_I, "number of frames of the sequence"),
    "layers": (_list(_S), "layers that the sequence has"),
    "action_step": (_I, "frames between action labels: 1, or 15 for labels once a second"),
    "keyframes": (_list(_I), "frame numbers of the keyframes"),
    "frames": (_list(_I), "frame numbers that can be observed"),
    "first_frame": (_I, "first frame with a label"),
    "last_frame": (_I, "last frame with a label"),
    "start": (_I, "frame of the start that a question expects, half a step earlier for labels once a second"),
    "end": (_I, "frame of the end that a question expects, half a step later for labels once a second"),
    "quiet_from": (_I, "first frame from which the action is false until the segment begins"),
    "closed": (_B, "the person is present for a second after the end, and the action is false"),
    "family": (_S, "family of templates"),
    "template": (_S, "name of the template"),
    "question": (_S, "text of the question"),
    "choices": (_list(_S), "the four answers to choose from, numbered from 1 in answers; empty for frames and spans"),
    "answer_mode": (_S, "kind of answer"),
    "answer": (_S, "the answer, as JSON"),
    "target_track": (_I, "track of the question's target"),
    "plan": (_S, "the plan, as JSON"),
    "proofs": (_S, "each proof with its result, as JSON; `holds` is null if the proof was not run"),
    "distractors": (_S, "reason for each wrong choice, as JSON"),
    "rules": (_S, "hash of the rules of the generation"),
    "hops": (_I, "number of relations of the plan, 4 for a fork-join; `stats` and `report` count a fork-join as 2"),
    "time_gap_s": (_F, "seconds from the description to the last needed time"),
    "separation_deg": (_F, "turn of the target from the description to the decisive frame, degrees"),
    "people_in_scene": (_I, "number of people with a box at the time of the description"),
    "bindings": (_S, "tracks and frames of the plan's names, as JSON"),
    "needed": (_S, "boxes that a method must see, as JSON"),
    "kind": (_S, "kind of row: count or example"),
    "rule": (_S, "the rule that refused the candidate"),
    "candidates": (_LONG, "number of refused candidates"),
    "detail": (_S, "details of the example's refusal"),
    "reviewer": (_S, "the reviewer"),
    "decision": (_S, "the decision"),
    "reason": (_S, "the reason"),
    "method": (_S, "the method"),
    "model": (_S, "the model"),
    "synthetic": (_B, "made with the simulated model or the sample world: no result about JRDB"),
    "created": (_S, "start time of the run, ISO 8601"),
    "settings": (_S, "all other settings of the run, as JSON"),
    "status": (_S, "answered; invalid (answer or box missing because output could not be read); or error"),
    "verdict": (_S, "support by the world model: certain, supported or guess; null without a world model"),
    "evidence_frame": (_I, "frame of the evidence box"),
    "evidence_x": (_F, "left edge of the evidence box, stitched pixels"),
    "evidence_y": (_F, "upper edge of the evidence box"),
    "evidence_w": (_F, "width of the evidence box"),
    "evidence_h": (_F, "height of the evidence box"),
    "n_observations": (_I, "number of observations"),
    "n_model_calls": (_I, "number of model calls"),
    "prompt_tokens": (_LONG, "tokens sent to the model"),
    "completion_tokens": (_LONG, "tokens written by the model"),
    "step": (_I, "number of the turn"),
    "tool": (_S, "the tool"),
    "arguments": (_S, "arguments of the tool, JSON"),
    "accepted": (_B, "false: the write was refused and the world model is unchanged"),
    "fact": (_S, "the fact stored in the world model, JSON"),
    "request": (_S, "the request, without image bytes"),
    "response": (_S, "the response"),
    "answer_score": (_CODE, "1 for a right answer"),
    "evidence_score": (_CODE, "1 for a right box"),
    "combined_score": (_CODE, "1 if answer and box are right"),
    "invalid": (_B, "the output could not be read"),
}
"""Type and meaning of each column in every table, except the entries of `SPECIAL`."""

SPECIAL: Final[dict[tuple[str, str], tuple[pa.DataType, str]]] = {
    ("annotations_social_activities", "value"): (_F, "value of the attribute, null if annotators could not tell"),
    ("annotations_boxes_3d", "w"): (_F, "width, metres"),
    ("annotations_boxes_3d", "h"): (_F, "height, metres"),
    ("annotations_boxes_3d", "distance"): (_F, "metres from the robot, as written"),
    ("annotations_calibration", "cx"): (_F, "principal point across, pixels"),
    ("annotations_calibration", "cy"): (_F, "principal point down, pixels"),
    ("annotations_listed", "layer"): (_S, "interactions or handles"),
    ("intervals_sequence", "has_attributes"): (_B, "some record of the sequence has attributes"),
    ("predictions", "answer"): (_S, "the answer as JSON, null for none"),
    ("predictions", "raw"): (_S, "the model's last text"),
    ("world", "number"): (_I, "number of the write, from 0"),
    ("world", "step"): (_I, "number of the model call that made the write"),
    ("world", "reason"): (_S, "reason of the refusal"),
}
"""Type and meaning of a column in one table, by table and column."""


def column(view: str, name: str) -> tuple[pa.DataType, str]:
    """Return type and meaning of a column of a view."""
    return SPECIAL.get((view, name)) or COLUMNS[name]


ABOUT: Final[dict[str, str]] = {}
"""Content of each view, in a sentence."""


def _schema(view: str, columns: str) -> pa.Schema:
    """Return the schema of columns named in a text; `?` marks a nullable column."""
    names = [(name.rstrip("?"), name.endswith("?")) for name in columns.split()]
    return pa.schema([pa.field(name, column(view, name)[0], nullable) for name, nullable in names])


def _schemas(prefix: str, tables: dict[str, tuple[str, str]]) -> dict[str, pa.Schema]:
    """Return schemas by table, from the content and the columns of each table."""
    ABOUT.update({prefix + table: about for table, (about, _) in tables.items()})
    return {table: _schema(prefix + table, columns) for table, (_, columns) in tables.items()}


_ANNOTATIONS: Final = {
    "frames": ("Annotated frames of each layer, including frames without records.", "sequence layer frame records"),
    "boxes_2d": (
        "Boxes of people in the stitched panorama, with their attributes.",
        "sequence frame track x y w h has_attributes occlusion? truncated? interpolated? no_eval? has_actions file_id?",
    ),
    # A label with an unreadable code (difficulty null) makes the action unknown, like a hard label.
    "actions": ("Action labels of people.", "sequence frame track action raw difficulty?"),
    "groups": ("Group of each person.", "sequence frame track cluster difficulty?"),
    "social_activities": ("Shared activities of a person, as written.", "sequence frame track activity value?"),
    "boxes_3d": (
        "Boxes of people in the robot frame (x forward, y left, z up), metres.",
        "sequence frame track cx cy cz l w h rot_z distance? num_points? interpolated? no_eval?",
    ),
    "demographics": ("Gender, age and ethnicity labels.", "sequence frame track attribute value? raw difficulty?"),
    "interactions": ("Interaction labels of two people.", "sequence frame track partner label raw difficulty?"),
    # Abbreviations of the annotators: bpc is what the bodies are on, ssc the salient surroundings.
    "group_info": (
        "Attributes of a group in a member's record: venue, aim, bpc, ssc, location, inter.",
        "sequence frame track attribute value? raw difficulty?",
    ),
    # (object, category_id) identifies the thing in `panoptic`.
    "handles": ("Labels of handling a thing.", "sequence frame track object category_id verb raw difficulty?"),
    "listed": (
        "People whose whole list of a layer could be read, so a fact without a label is false.",
        "sequence layer frame track",
    ),
    "poses": ("Key points of people.", "sequence frame track keypoints"),
    # Stuff, such as walls and sky, has no tracks: object is null.
    "panoptic": (
        "Segments of things and stuff, with run-length codes.",
        "sequence frame object? category_id x? y? w? h? area? segmentation?",
    ),
    # Each file numbers the categories in its own way.
    "categories": ("Names of the panoptic layer's category numbers.", "sequence category_id category? raw"),
    "timestamps": ("Time of each frame by sensor: images or clouds.", "sequence sensor frame timestamp"),
    "calibration": ("Pinhole intrinsics of the cameras, pixels.", "sequence sensor width? height? fx fy cx cy"),
}
ANNOTATIONS: Final = _schemas("annotations_", _ANNOTATIONS)

_INTERVALS: Final = {
    "sequence": ("One row per sequence.", "sequence fps frame_count layers action_step keyframes has_attributes"),
    "frames": (
        "Every annotated frame, with seconds from frame 0 by timestamps or else by fps.",
        "sequence frame seconds keyframe annotated image",
    ),
    "persons": (
        "Every person, with the attributes on which all votes agree.",
        "sequence track gender? age? ethnicity? first_frame last_frame",
    ),
    "demographics": ("Votes of frames for each attribute of a person.", "sequence track attribute value votes chosen"),
    "sightings": (
        "One row per 2D box: direction, distance, visibility, pose and group at that frame.",
        "sequence frame track x y w h angle occlusion? no_eval clear face_visible? listed interactions_listed "
        "handles_listed pose? cluster? group_size? sector? located distance? distance_word? "
        "distance_word_other? cx? cy? cz? heading?",
    ),
    "object_sightings": (
        "One row per box of a thing at a frame of the panoptic layer: its direction.",
        "sequence frame object category_id x y w h angle",
    ),
    "presences": (
        "Consecutive frames with a box of a person; certain if the box is a clear view.",
        "sequence track first last first_s last_s certain",
    ),
    "absences": (
        "Consecutive annotated frames without a box between two boxes of a person; certain if a second away too.",
        "sequence track first last first_s last_s certain",
    ),
    # Not certain are hard and unreadable labels, and poses beside another pose.
    "actions": (
        "Written action labels of people, as intervals of frames.",
        "sequence track action first last first_s last_s difficulty? certain",
    ),
    "memberships": ("Written group labels of people.", "sequence track cluster first last first_s last_s certain"),
    # An interaction that one record states holds for both people, so it has rows in both directions.
    "interactions": (
        "Written interaction labels of two people, as intervals of frames, in both directions.",
        "sequence source target label first last first_s last_s certain",
    ),
    "handles": (
        "Written labels of what people do with things, as intervals of frames.",
        "sequence track object category_id verb first last first_s last_s certain",
    ),
    "objects": (
        "Things with a track, without people; category null if unknown or missing in the panoptic layer.",
        "sequence object category_id category? first_frame? last_frame?",
    ),
    "group_info": ("Votes for each attribute of a group.", "sequence cluster attribute value votes chosen"),
    # In the robot's view a row covers one keyframe. An uncertain one may have several targets.
    "beside": (
        "Place of the target seen from the source, such as 'left, close', or first to a side in the robot's view.",
        "sequence source target label first last first_s last_s certain",
    ),
    "segments": ("Stable segments of actions.", "sequence track action first last start end quiet_from closed"),
}
LABELED: Final = ("actions", "memberships", "interactions", "handles")
"""Interval tables of written labels. Each has a table `possible_<name>` of the facts that may hold without a label."""

_POSSIBLE: Final = {
    f"possible_{name}": (
        f"Facts that may hold without a label, with the keys of `intervals_{name}`.",
        _INTERVALS[name][1].replace("difficulty? ", "").replace("certain", "gap"),
    )
    for name in LABELED
}
INTERVALS: Final = _schemas("intervals_", _INTERVALS | _POSSIBLE)

_QUESTIONS: Final = {
    "questions": ("The public questions.", "question_id sequence family template question choices answer_mode"),
    "sequences": ("Frames of each sequence that can be observed.", "sequence fps frame_count frames"),
    "answers": (
        "Answer, target, plan and proofs of each question.",
        "question_id answer target_track plan proofs distractors rules hops time_gap_s separation_deg "
        "people_in_scene bindings needed",
    ),
    "evidence": (
        "Every box of every target, to be joined by sequence and `answers.target_track`.",
        "sequence track frame x y w h",
    ),
    "rejected": (
        "Refused candidates: counts by sequence, template and rule, and up to 100 examples of each.",
        "kind sequence family template rule candidates target_track? plan? detail?",
    ),
    "reviews": ("Decisions of reviewers about questions.", "question_id reviewer decision reason"),
}
QUESTIONS: Final = _schemas("", _QUESTIONS)

_RUNS: Final = {
    "runs": ("Each run, from its `run.json`.", "run_id method model synthetic created settings"),
    "predictions": (
        "Answers of each run.",
        "run_id question_id status answer? evidence_frame? evidence_x? evidence_y? evidence_w? evidence_h? raw "
        "reason verdict? n_observations n_model_calls prompt_tokens completion_tokens seconds",
    ),
    "steps": ("Every model turn and observation of each run.", "run_id question_id step kind request response seconds"),
    "world": (
        "Every write of an agent into its world model, accepted or refused, in order.",
        "run_id question_id number step tool arguments accepted reason fact",
    ),
    "scores": ("Scores of each run.", "run_id question_id answer_score evidence_score combined_score invalid"),
}
RUNS: Final = _schemas("", _RUNS)

CANDIDATES: Final = _schema("candidates", "sequence family template target_track plan answer")
"""Schema of `generate --candidates FILE`. Answers are texts of choices, or stored JSON in other answer modes."""

PRIVATE: Final = ("answers", "evidence", "rejected", "reviews")
"""Tables of `questions/` that a process with a model never opens."""

CANARY: Final = "jrdb-avr benchmark data must not be trained on; canary 4c1f0c0e-2f0b-4f0e-9f44-8e2a6a1d7b35"
"""Text under the key `canary` in the metadata of every released file."""

GENERATION_KEY: Final = "generation"
"""Metadata key of the identifier that all tables of one generation share."""


def views() -> Iterator[tuple[str, pa.Schema, bool]]:
    """Yield name, schema and privacy of each view."""
    for prefix, group in (("annotations_", ANNOTATIONS), ("intervals_", INTERVALS), ("", QUESTIONS), ("", RUNS)):
        for name, schema in group.items():
            yield f"{prefix}{name}", schema, group is QUESTIONS and name in PRIVATE
