"""The reference page of the store's tables, `docs/tables.md`, written from their schemas.

python -m jrdb_avr.queries.tables > docs/tables.md
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pyarrow as pa

from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS, PRIVATE, QUESTIONS, RUNS

ABOUT: Final[dict[str, str]] = {
    "annotations_frames": "Which frames each layer knows, also where it says that nobody is there.",
    "annotations_boxes_2d": "Boxes of people in the stitched panorama, with their attributes.",
    "annotations_actions": "Action labels of people.",
    "annotations_groups": "Which group a person is said to be in.",
    "annotations_social_activities": "Shared activities of a person, as written.",
    "annotations_boxes_3d": "Boxes of people in the robot frame (x forward, y left, z up), metres.",
    "annotations_demographics": "Gender, age and ethnicity labels, one row per label.",
    "annotations_interactions": "Interaction labels of a person with a partner, mostly in both directions.",
    "annotations_group_info": "What a member's record says of its group.",
    "annotations_handles": "What a person does with which thing.",
    "annotations_listed": "People whose whole list of a layer could be read: what it does not hold is false.",
    "annotations_poses": "Key points of people.",
    "annotations_panoptic": "Segments of things and stuff, with run-length codes.",
    "annotations_categories": "Names of the panoptic layer's category numbers.",
    "annotations_timestamps": "When each sensor took each frame.",
    "annotations_calibration": "Intrinsics of the cameras behind the panorama.",
    "intervals_sequence": "One row per sequence.",
    "intervals_frames": "Every frame that anything is known of.",
    "intervals_persons": "Everybody, with the attributes that the votes chose.",
    "intervals_demographics": "How many frames say what of a person.",
    "intervals_sightings": "One row per 2D box: direction, distance, visibility, pose and group at that frame.",
    "intervals_actions": "From when to when a person does what.",
    "intervals_memberships": "From when to when a person is in which group.",
    "intervals_interactions": "From when to when two people share what, both directions.",
    "intervals_handles": "From when to when a person does what with which thing.",
    "intervals_objects": "Things with a track, people left out.",
    "intervals_group_info": "What members' records say of their group, with votes.",
    "intervals_beside": "Where the target is, seen from the source.",
    "intervals_segments": "Stable segments of actions, which questions about starts and spans use.",
    "questions": "The public questions.",
    "sequences": "The frames that can be looked at.",
    "answers": "Answer, target, plan and proofs of each question.",
    "evidence": "Every box of each question's target.",
    "rejected": "Refused candidates: counts by rule, and examples.",
    "reviews": "What people decided about questions.",
    "predictions": "What each run answered.",
    "steps": "Every turn and look of each run.",
    "world": "Every write of an agent into its world model, accepted or refused, in order.",
    "scores": "What each run scored.",
}

COLUMNS: Final[dict[str, str]] = {
    "sequence": "name of the sequence",
    "layer": "layer of labels",
    "frame": "frame number",
    "track": "the person, within the sequence",
    "records": "records of the layer at the frame",
    "x": "left edge, stitched pixels",
    "y": "upper edge, stitched pixels",
    "w": "width",
    "h": "height",
    "first": "first frame, inclusive",
    "last": "last frame, inclusive",
    "first_s": "seconds of the first frame",
    "last_s": "seconds of the last frame",
    "certain": "false: the fact is unknown, it could be so",
    "gap": "a closed gap between two intervals",
    "difficulty": "annotators' code: 1 easy, 2 medium, 3 hard, null unreadable",
    "raw": "the label as written",
    "cluster": "number of the group",
    "attribute": "which attribute",
    "value": "its value, null where annotators could not tell",
    "votes": "frames that say so",
    "chosen": "more than half of the votes say so",
    "source": "the person from whom it is seen or said",
    "target": "the other person",
    "partner": "the other person",
    "label": "the relation",
    "verb": "what is done with the thing",
    "object": "track of the thing, within its category",
    "category_id": "number of the thing's category in its file",
    "category": "name of the category, null if unknown",
    "action": "name of the action",
    "pose": "the one certain pose, null if unknown",
    "seconds": "time in seconds",
    "keyframe": "a keyframe of the sequence",
    "annotated": "the 2D layer knows the frame",
    "image": "there is a panorama",
    "angle": "panorama angle, degrees: 180 ahead, 90 left",
    "sector": "direction as the robot sees it",
    "sector_other": "the other possible sector near an edge",
    "distance": "metres from the robot",
    "distance_word": "the distance in a word",
    "distance_word_other": "the other possible word near a bound",
    "clear": "a clear view under the rules",
    "face_visible": "head or an eye marked visible, null without a pose",
    "listed": "the person has an action list at the frame",
    "interactions_listed": "the interaction list was read whole",
    "handles_listed": "the list of things handled was read whole",
    "group_size": "people in the group, null if unknown",
    "located": "3D box with lidar points",
    "heading": "direction of the person, radians, left is positive",
    "occlusion": "how far it is hidden",
    "no_eval": "left out of evaluation by the annotators",
    "sensor": "camera, or kind of sensor",
    "timestamp": "seconds since the epoch",
    "question_id": "id of the question",
    "run_id": "id of the run",
    "segmentation": "run-length code as written",
    "keypoints": "17 times x, y, visibility",
    "gender": "by vote, null if unknown",
    "age": "by vote, null if unknown",
    "ethnicity": "by vote, null if unknown",
    "has_attributes": "the record came with attributes",
    "has_actions": "the record has a usable action list",
    "truncated": "cut off by the image, as annotated",
    "interpolated": "filled in between two annotated boxes, as annotated",
    "file_id": "identifier of the label in its file",
    "activity": "the shared activity",
    "cx": "centre, metres forward of the robot",
    "cy": "centre, metres left of the robot",
    "cz": "centre, metres up",
    "l": "length, metres",
    "rot_z": "rotation about the vertical axis as written, radians",
    "num_points": "lidar points inside",
    "area": "pixels of the segment",
    "width": "width of the image, pixels",
    "height": "height of the image, pixels",
    "fx": "focal length across, pixels",
    "fy": "focal length down, pixels",
    "fps": "frames per second",
    "frame_count": "frames of the sequence",
    "layers": "layers that the sequence has",
    "action_step": "frames between action labels: 1, or 15 where they come once a second",
    "keyframes": "frame numbers of the keyframes",
    "frames": "frame numbers that can be looked at",
    "first_frame": "first frame with a label",
    "last_frame": "last frame with a label",
    "start": "when it begins, as a question asks for it: frame, half a step earlier where labels come once a second",
    "end": "when it ends, likewise",
    "quiet_from": "from here to the segment the action is false",
    "closed": "the action is false for a second after the end, with the person present",
    "family": "family of templates",
    "template": "which kind of question",
    "question": "the text",
    "choices": "the four answers to choose from; empty for frames and spans",
    "answer_mode": "how it is answered",
    "answer": "the answer, as JSON",
    "target_track": "the person asked about",
    "plan": "the question as a structure, as JSON",
    "proofs": "each proof with its result, as JSON",
    "distractors": "why each wrong choice is there, as JSON",
    "rules": "hash of the rules it was made under",
    "hops": "relations that the question goes by",
    "time_gap_s": "seconds from the description to the last time that it takes",
    "separation_deg": "turn of the person asked about, from the description to what decides, degrees",
    "people_in_scene": "people with a box at the time of the description",
    "bindings": "who and when the names of the plan stand for, as JSON",
    "needed": "boxes that have to be seen, as JSON",
    "kind": "what kind of row",
    "rule": "the rule that refused",
    "candidates": "how many were refused",
    "detail": "why this one was refused",
    "reviewer": "who decided",
    "decision": "what was decided",
    "reason": "why, in words",
    "status": "how it went",
    "evidence_frame": "frame of the evidence box",
    "evidence_x": "left edge of the evidence box, stitched pixels",
    "evidence_y": "its upper edge",
    "evidence_w": "its width",
    "evidence_h": "its height",
    "n_observations": "looks taken",
    "n_model_calls": "calls of the model",
    "prompt_tokens": "tokens sent to the model",
    "completion_tokens": "tokens that the model wrote",
    "step": "number of the turn",
    "tool": "which tool wrote",
    "arguments": "what the tool was given, JSON",
    "accepted": "false: refused, the world model is unchanged",
    "fact": "what went into the world model, JSON",
    "request": "what was asked, without image bytes",
    "response": "what came back",
    "answer_score": "1 for a right answer",
    "evidence_score": "1 for a right box",
    "combined_score": "1 where both are right",
    "invalid": "no usable answer",
}
"""What a column means wherever it stands."""

SPECIAL: Final[dict[tuple[str, str], str]] = {
    ("annotations_boxes_3d", "w"): "width, metres",
    ("annotations_boxes_3d", "h"): "height, metres",
    ("annotations_boxes_3d", "distance"): "metres from the robot, as written",
    ("annotations_calibration", "cx"): "principal point across, pixels",
    ("annotations_calibration", "cy"): "principal point down, pixels",
    ("annotations_listed", "layer"): "interactions or handles",
    ("intervals_sequence", "has_attributes"): "some record came with attributes",
    ("predictions", "answer"): "what was answered, null for nothing",
    ("predictions", "raw"): "the model's last words",
    ("predictions", "seconds"): "how long it took",
    ("steps", "seconds"): "how long it took",
    ("world", "number"): "number of the write, from 0",
    ("world", "step"): "number of the model call that it came with",
    ("world", "reason"): "why it was refused",
}
"""What it means in one table."""


def page() -> str:
    """The page, in Markdown."""
    lines = [
        "# Tables of a store",
        "",
        "Every table is a view in `jrdb-avr sql`; `SHOW TABLES` and `DESCRIBE intervals_actions` work there too. A",
        "table that is not written yet is an empty view. Written by `python -m jrdb_avr.queries.tables`.",
        "",
        "`sightings_keypoints` is `intervals_sightings` with one column more: `keypoints`, those of",
        "`annotations_poses` at the same frame, or null.",
        "",
    ]
    for name, schema, private in tables():
        secret = " Private: never opened by the process that talks to a model." if private else ""
        lines += [f"## `{name}`", "", f"{ABOUT[name]}{secret}", "", "| column | type | meaning |", "|--|--|--|"]
        lines += [
            f"| `{field.name}` | {_type(field)} | {SPECIAL.get((name, field.name)) or COLUMNS[field.name]} |"
            for field in schema
        ]
        lines.append("")
    return "\n".join(lines)


def tables() -> Iterator[tuple[str, pa.Schema, bool]]:
    """Name of the view, schema, and whether it is private."""
    for prefix, group in (("annotations_", ANNOTATIONS), ("intervals_", INTERVALS), ("", QUESTIONS), ("", RUNS)):
        for name, schema in group.items():
            yield f"{prefix}{name}", schema, group is QUESTIONS and name in PRIVATE


def _type(field: pa.Field) -> str:
    return f"{field.type}".replace(" not null", "").replace("item: ", "") + (" or null" if field.nullable else "")


if __name__ == "__main__":
    print(page())
