"""Arrow schemas of every Parquet table, with the meaning of each column: the names are part of the public interface.

Annotation tables hold what the files state, one row per fact, with raw values. Interval tables hold what follows from
them under `LoadRules`; all of them can be rebuilt. Frames are integer label keys; boxes are stitched pixels; 3D is in
metres in the robot frame (x forward, y left, z up); intervals are inclusive on both ends.
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
    "2d",
    "actions",
    "groups",
    "3d",
    "demographics",
    "interactions",
    "group_info",
    "handles",
    "pose",
    "panoptic",
    "timestamps",
    "images",
)
"""Layers of the `frames` table. Several may ride in one file and yet be annotated at different steps: `actions` and
`groups` come with the 2D boxes; `demographics`, `interactions` and `group_info` with the social file (or, where that
lacks, the reasoning file); `handles` with the reasoning file."""

COLUMNS: Final[dict[str, tuple[pa.DataType, str]]] = {
    "sequence": (_S, "name of the sequence"),
    "layer": (_S, "layer of labels"),
    "frame": (_I, "frame number"),
    "track": (_I, "the person, within the sequence"),
    "records": (_I, "records of the layer at the frame"),
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
    "attribute": (_S, "which attribute"),
    "value": (_S, "its value, null where annotators could not tell"),
    "votes": (_I, "frames with this value"),
    "chosen": (_B, "the value of more than half of the votes"),
    "source": (_I, "the person that the relation starts from"),
    "target": (_I, "the other person"),
    "partner": (_I, "the other person"),
    "label": (_S, "the relation"),
    "verb": (_S, "what is done with the thing"),
    "object": (_I, "track of the thing, within its category"),
    "category_id": (_I, "number of the thing's category in its file"),
    "category": (_S, "name of the category, null if unknown"),
    "action": (_S, "name of the action"),
    "pose": (_S, "the one certain pose, null if unknown"),
    "seconds": (_F, "time in seconds"),
    "keyframe": (_B, "a keyframe of the sequence"),
    "annotated": (_B, "the 2D layer knows the frame"),
    "image": (_B, "there is a panorama"),
    "angle": (_F, "panorama angle, degrees: 180 ahead, 90 left"),
    "sector": (_S, "direction as the robot sees it, null where it is between two"),
    "distance": (_F, "metres from the robot"),
    "distance_word": (_S, "the distance in a word"),
    "distance_word_other": (_S, "the other possible word near a bound"),
    "clear": (_B, "a clear view under the rules"),
    "face_visible": (_B, "head or an eye marked visible, null without a pose"),
    "listed": (_B, "the person has an action list at the frame"),
    "interactions_listed": (_B, "the interaction list was read whole"),
    "handles_listed": (_B, "the list of things handled was read whole"),
    "group_size": (_I, "people in the group, null if unknown"),
    "located": (_B, "3D box with lidar points"),
    "heading": (_F, "direction of the person, radians, left is positive"),
    "occlusion": (_S, "how far it is hidden"),
    "no_eval": (_B, "left out of evaluation by the annotators"),
    "sensor": (_S, "camera, or kind of sensor"),
    "timestamp": (_F, "seconds since the epoch"),
    "question_id": (_S, "id of the question"),
    "run_id": (_S, "id of the run"),
    "segmentation": (_S, "run-length code as written"),
    "keypoints": (_list(_F, 51), "17 times x, y, visibility"),
    "gender": (_S, "what all votes say, null if they differ"),
    "age": (_S, "what all votes say, null if they differ"),
    "ethnicity": (_S, "what all votes say, null if they differ"),
    "has_attributes": (_B, "the record came with attributes"),
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
    "area": (_F, "pixels of the segment"),
    "width": (_I, "width of the image, pixels"),
    "height": (_I, "height of the image, pixels"),
    "fx": (_F, "focal length across, pixels"),
    "fy": (_F, "focal length down, pixels"),
    "fps": (_F, "frames per second"),
    "frame_count": (_I, "frames of the sequence"),
    "layers": (_list(_S), "layers that the sequence has"),
    "action_step": (_I, "frames between action labels: 1, or 15 where they come once a second"),
    "keyframes": (_list(_I), "frame numbers of the keyframes"),
    "frames": (_list(_I), "frame numbers that can be observed"),
    "first_frame": (_I, "first frame with a label"),
    "last_frame": (_I, "last frame with a label"),
    "start": (_I, "frame of the start that a question expects: half a step earlier where labels come once a second"),
    "end": (_I, "frame of the end, likewise"),
    "quiet_from": (_I, "from here to the segment the action is false"),
    "closed": (_B, "the action is false for a second after the end, with the person present"),
    "family": (_S, "family of templates"),
    "template": (_S, "name of the template"),
    "question": (_S, "text of the question"),
    "choices": (_list(_S), "the four answers to choose from, numbered from 1 in answers; empty for frames and spans"),
    "answer_mode": (_S, "kind of answer"),
    "answer": (_S, "the answer, as JSON"),
    "target_track": (_I, "track of the question's target"),
    "plan": (_S, "the plan, as JSON"),
    "proofs": (_S, "each proof with its result, as JSON; `holds` is null where it is not run"),
    "distractors": (_S, "why each wrong choice is there, as JSON"),
    "rules": (_S, "hash of the rules it was made under"),
    "hops": (_I, "relations of the plan, four of a fork-join; `stats` and `report` count two, one after another"),
    "time_gap_s": (_F, "seconds from the description to the last time that it takes"),
    "separation_deg": (_F, "turn of the target from the description to the decisive frame, degrees"),
    "people_in_scene": (_I, "people with a box at the time of the description"),
    "bindings": (_S, "tracks and frames of the plan's names, as JSON"),
    "needed": (_S, "boxes that a method must see, as JSON"),
    "kind": (_S, "kind of row: count or example"),
    "rule": (_S, "the rule that refused"),
    "candidates": (_LONG, "how many were refused"),
    "detail": (_S, "why the example was refused"),
    "reviewer": (_S, "the reviewer"),
    "decision": (_S, "the decision"),
    "reason": (_S, "the reason"),
    "method": (_S, "the method"),
    "model": (_S, "the model"),
    "synthetic": (_B, "of the simulated model or of the sample world: no result about JRDB"),
    "created": (_S, "when the run began, ISO 8601"),
    "settings": (_S, "what else shaped the run, as JSON"),
    "status": (_S, "answered; invalid: answer or box missing, as output could not be read; or error"),
    "verdict": (_S, "what a world model makes of the answer: certain, supported or guess; null without one"),
    "evidence_frame": (_I, "frame of the evidence box"),
    "evidence_x": (_F, "left edge of the evidence box, stitched pixels"),
    "evidence_y": (_F, "its upper edge"),
    "evidence_w": (_F, "its width"),
    "evidence_h": (_F, "its height"),
    "n_observations": (_I, "observations made"),
    "n_model_calls": (_I, "calls of the model"),
    "prompt_tokens": (_LONG, "tokens sent to the model"),
    "completion_tokens": (_LONG, "tokens written by the model"),
    "step": (_I, "number of the turn"),
    "tool": (_S, "the tool"),
    "arguments": (_S, "arguments of the tool, JSON"),
    "accepted": (_B, "false: refused, the world model is unchanged"),
    "fact": (_S, "the fact stored in the world model, JSON"),
    "request": (_S, "the request, without image bytes"),
    "response": (_S, "the response"),
    "answer_score": (_CODE, "1 for a right answer"),
    "evidence_score": (_CODE, "1 for a right box"),
    "combined_score": (_CODE, "1 where both are right"),
    "invalid": (_B, "output could not be read"),
}
"""Type and meaning of a column wherever it stands; see `SPECIAL`."""

SPECIAL: Final[dict[tuple[str, str], tuple[pa.DataType, str]]] = {
    ("annotations_social_activities", "value"): (_F, "its value, null where annotators could not tell"),
    ("annotations_boxes_3d", "w"): (_F, "width, metres"),
    ("annotations_boxes_3d", "h"): (_F, "height, metres"),
    ("annotations_boxes_3d", "distance"): (_F, "metres from the robot, as written"),
    ("annotations_calibration", "cx"): (_F, "principal point across, pixels"),
    ("annotations_calibration", "cy"): (_F, "principal point down, pixels"),
    ("annotations_listed", "layer"): (_S, "interactions or handles"),
    ("intervals_sequence", "has_attributes"): (_B, "some record came with attributes"),
    ("predictions", "answer"): (_S, "the answer as JSON, null for none"),
    ("predictions", "raw"): (_S, "the model's last text"),
    ("predictions", "seconds"): (_F, "duration, seconds"),
    ("steps", "seconds"): (_F, "duration, seconds"),
    ("world", "number"): (_I, "number of the write, from 0"),
    ("world", "step"): (_I, "number of the model call that it came with"),
    ("world", "reason"): (_S, "why it was refused"),
}
"""Type and meaning of a column in one table."""


def column(view: str, name: str) -> tuple[pa.DataType, str]:
    """Type and meaning of a column of a view."""
    return SPECIAL.get((view, name)) or COLUMNS[name]


ABOUT: Final[dict[str, str]] = {}
"""What each view holds."""


def _schema(view: str, columns: str) -> pa.Schema:
    """Schema of named columns; `?` marks a column in which null is a value."""
    names = [(name.rstrip("?"), name.endswith("?")) for name in columns.split()]
    return pa.schema([pa.field(name, column(view, name)[0], nullable) for name, nullable in names])


def _schemas(prefix: str, tables: dict[str, tuple[str, str]]) -> dict[str, pa.Schema]:
    """Schemas by table, from what each table holds and its columns."""
    ABOUT.update({prefix + table: about for table, (about, _) in tables.items()})
    return {table: _schema(prefix + table, columns) for table, (_, columns) in tables.items()}


_ANNOTATIONS: Final = {
    # One row per (layer, frame) that the layer knows, also where it says "nobody here".
    "frames": ("Frames that each layer annotates, also those with nobody.", "sequence layer frame records"),
    # has_attributes: the record came with an `attributes` object. has_actions: with a usable action list.
    "boxes_2d": (
        "Boxes of people in the stitched panorama, with their attributes.",
        "sequence frame track x y w h has_attributes occlusion? truncated? interpolated? no_eval? has_actions file_id?",
    ),
    # difficulty null: a label with an unreadable code; it makes the action unknown, as a 3 does.
    "actions": ("Action labels of people.", "sequence frame track action raw difficulty?"),
    "groups": ("Group of each person.", "sequence frame track cluster difficulty?"),
    "social_activities": ("Shared activities of a person, as written.", "sequence frame track activity value?"),
    "boxes_3d": (
        "Boxes of people in the robot frame (x forward, y left, z up), metres.",
        "sequence frame track cx cy cz l w h rot_z distance? num_points? interpolated? no_eval?",
    ),
    # One row per label. attribute: gender, age or ethnicity. value null: annotators could not tell.
    "demographics": (
        "Gender, age and ethnicity labels, one row per label.",
        "sequence frame track attribute value? raw difficulty?",
    ),
    # One row per (person, partner, label) as written, so mostly both directions.
    "interactions": (
        "Interaction labels of a person with a partner, mostly in both directions.",
        "sequence frame track partner label raw difficulty?",
    ),
    # attribute: venue, aim, bpc (what the body is on), ssc (salient surroundings), location or inter.
    "group_info": (
        "Attributes of a group in a member's record.",
        "sequence frame track attribute value? raw difficulty?",
    ),
    # (object, category_id) is the thing in `panoptic`; the name of the category is in `categories`.
    "handles": ("What a person does with a thing.", "sequence frame track object category_id verb raw difficulty?"),
    # A person whose whole list of `layer` (interactions or handles) could be read: what it does not hold is false.
    "listed": (
        "People whose whole list of a layer could be read: what it does not hold is false.",
        "sequence layer frame track",
    ),
    # keypoints: 17 times x, y in stitched pixels and visibility (0 not visible, 1 occluded, 2 visible).
    "poses": ("Key points of people.", "sequence frame track keypoints"),
    # object null: stuff (walls, sky) has no tracks. segmentation: the run-length code as written.
    "panoptic": (
        "Segments of things and stuff, with run-length codes.",
        "sequence frame object? category_id x? y? w? h? area? segmentation?",
    ),
    # Category numbers are the file's own. category null: a name outside the vocabulary.
    "categories": ("Names of the panoptic layer's category numbers.", "sequence category_id category? raw"),
    # sensor: images or clouds. timestamp: seconds since the epoch.
    "timestamps": ("When each sensor took each frame.", "sequence sensor frame timestamp"),
    # Pinhole intrinsics of the cameras that the panorama is stitched from, pixels.
    "calibration": ("Intrinsics of the cameras behind the panorama.", "sequence sensor width? height? fx fy cx cy"),
}
ANNOTATIONS: Final = _schemas("annotations_", _ANNOTATIONS)

_INTERVALS: Final = {
    # One row. keyframes: int32 list; layers: which of LAYERS the sequence has; action_step: 1 or 15.
    "sequence": ("One row per sequence.", "sequence fps frame_count layers action_step keyframes has_attributes"),
    # seconds: from the timestamps where there are any, counted from frame 0; else frame / fps.
    # annotated: the 2D layer knows the frame (its boxes are all the people there are).
    "frames": ("Every frame that some layer annotates.", "sequence frame seconds keyframe annotated image"),
    "persons": (
        "Every person, with the attributes that most frames agree on.",
        "sequence track gender? age? ethnicity? first_frame last_frame",
    ),
    # How many frames say what of a person; chosen: the value that more than half of them say.
    "demographics": ("Votes of frames for each attribute of a person.", "sequence track attribute value votes chosen"),
    # One row per 2D box.
    # clear: the clear view of the rules. located: 3D box with lidar points at this frame.
    # listed: the person has an action list, so an action not performed is false. pose: the one certain pose.
    # face_visible: head or an eye is marked visible; null where the person has no pose at this frame.
    # interactions_listed, handles_listed: the list was read, so what it does not hold is false.
    # group_size: null when unknown. sector: the certain one, null between two. distance_word: the word; *_other: the
    # second possible word near a bound, null when the first is certain. A null distance_word: the distance is unknown.
    "sightings": (
        "One row per 2D box: direction, distance, visibility, pose and group at that frame.",
        "sequence frame track x y w h angle occlusion? no_eval clear face_visible? listed interactions_listed "
        "handles_listed pose? cluster? group_size? sector? located distance? distance_word? "
        "distance_word_other? cx? cy? cz? heading?",
    ),
    # A thing of `objects` at a frame of the panoptic layer, where that gives it a box.
    "object_sightings": (
        "One row per box of a thing: its direction at that frame.",
        "sequence frame object category_id x y w h angle",
    ),
    # certain = false: a box without a clear view.
    "presences": (
        "Frames in a row in which a person has a box.",
        "sequence track first last first_s last_s certain",
    ),
    # Between the first and the last box, annotated frames only. certain = false: a box one second before or after.
    "absences": (
        "Frames in a row in which a person has no box, between two of them.",
        "sequence track first last first_s last_s certain",
    ),
    # certain = false: hard or unreadable label, or one of two poses.
    "actions": (
        "Written action labels of people, as intervals of frames.",
        "sequence track action first last first_s last_s difficulty? certain",
    ),
    "possible_actions": (
        "Actions that people may perform without a label of that action.",
        "sequence track action first last first_s last_s gap",
    ),
    "memberships": (
        "Written group labels of people, as intervals of frames.",
        "sequence track cluster first last first_s last_s certain",
    ),
    "possible_memberships": (
        "Groups that people may belong to without a label.",
        "sequence track cluster first last first_s last_s gap",
    ),
    # Both directions of every fact, as an interaction that one record states holds for both people.
    "interactions": (
        "Written interaction labels of two people, as intervals of frames, in both directions.",
        "sequence source target label first last first_s last_s certain",
    ),
    "possible_interactions": (
        "Interactions that two people may have without a label of that interaction, in both directions.",
        "sequence source target label first last first_s last_s gap",
    ),
    "handles": (
        "Written labels of what people do with things, as intervals of frames.",
        "sequence track object category_id verb first last first_s last_s certain",
    ),
    "possible_handles": (
        "What people may do with things without a label of that verb.",
        "sequence track object category_id verb first last first_s last_s gap",
    ),
    # Things with a track, people left out. category null: unknown, or the panoptic layer does not hold the thing.
    "objects": (
        "Things with a track, people left out.",
        "sequence object category_id category? first_frame? last_frame?",
    ),
    # What members' records say of their group; chosen: what more than half of those that tell the attribute say.
    "group_info": (
        "Votes of members' records for each attribute of their group.",
        "sequence cluster attribute value votes chosen",
    ),
    # source -> target: where the target is, seen from the source. Person frame: label '<sector>, <distance word>'.
    # Robot view: one-keyframe rows of FIRST_LEFT and FIRST_RIGHT; an uncertain one may have several targets.
    "beside": (
        "Where the target is, seen from the source.",
        "sequence source target label first last first_s last_s certain",
    ),
    # Stable segments: [first, last]; start and end as questions expect them: half a step wider at 1 Hz.
    # quiet_from: the earliest frame from which on the action is false at every annotated frame before the segment.
    # closed: the action is false, and the person present, for a second after the end.
    "segments": (
        "Stable segments of actions, which questions about starts and spans use.",
        "sequence track action first last start end quiet_from closed",
    ),
}
INTERVALS: Final = _schemas("intervals_", _INTERVALS)

LABELED: Final = ("actions", "memberships", "interactions", "handles")
"""Interval tables of written labels. Each has a table `possible_<name>` of the facts that may hold without a label."""

_QUESTIONS: Final = {
    "questions": ("The public questions.", "question_id sequence family template question choices answer_mode"),
    "sequences": ("Frames of each sequence that can be observed.", "sequence fps frame_count frames"),
    "answers": (
        "Answer, target, plan and proofs of each question.",
        "question_id answer target_track plan proofs distractors rules hops time_gap_s separation_deg "
        "people_in_scene bindings needed",
    ),
    "evidence": ("Every box of every target of a question, by `answers.target_track`.", "sequence track frame x y w h"),
    # kind "count": candidates that a rule refuses, per sequence and template; kind "example": one of them.
    "rejected": (
        "Refused candidates: counts by rule, and examples.",
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
"""`generate --candidates FILE`; a choice answer as its text, any other as its stored JSON."""

PRIVATE: Final = ("answers", "evidence", "rejected", "reviews")
"""Tables of `questions/` that the process talking to a model never opens."""

CANARY: Final = "jrdb-avr benchmark data must not be trained on; canary 4c1f0c0e-2f0b-4f0e-9f44-8e2a6a1d7b35"
"""Stored under the key `canary` in the metadata of every released file."""

GENERATION_KEY: Final = "generation"
"""Metadata key of the mark that the tables of one generation share."""


def views() -> Iterator[tuple[str, pa.Schema, bool]]:
    """Name, schema and privacy of each view."""
    for prefix, group in (("annotations_", ANNOTATIONS), ("intervals_", INTERVALS), ("", QUESTIONS), ("", RUNS)):
        for name, schema in group.items():
            yield f"{prefix}{name}", schema, group is QUESTIONS and name in PRIVATE
