"""Arrow schemas of every Parquet table: the column names are part of the public interface.

Annotation tables hold what the files say, one row per fact, raw values kept. Interval tables hold what follows from
them under `LoadRules`; all of them can be rebuilt. Frames are integer label keys; boxes are stitched pixels; 3D is in
metres in the robot frame (x forward, y left, z up); intervals are inclusive on both ends.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa

_S = pa.string()
_I = pa.int32()
_F = pa.float64()
_B = pa.bool_()


def _schema(*fields: tuple[str, pa.DataType] | tuple[str, pa.DataType, bool]) -> pa.Schema:
    """Fields as (name, type) or, where null is a value, (name, type, True)."""
    return pa.schema([pa.field(f[0], f[1], nullable=len(f) > 2) for f in fields])


_BOX = (("x", _F), ("y", _F), ("w", _F), ("h", _F))

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

ANNOTATIONS: Final[dict[str, pa.Schema]] = {
    # One row per (layer, frame) that the layer knows, also where it says "nobody here".
    "frames": _schema(("sequence", _S), ("layer", _S), ("frame", _I), ("records", _I)),
    # has_attributes: the record came with an `attributes` object. has_actions: with a usable action list.
    "boxes_2d": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        *_BOX,
        ("has_attributes", _B),
        ("occlusion", _S, True),
        ("truncated", _B, True),
        ("interpolated", _B, True),
        ("no_eval", _B, True),
        ("has_actions", _B),
        ("file_id", _S, True),
    ),
    # difficulty null: a label with an unreadable code; it makes the action unknown, as a 3 does.
    "actions": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("action", _S),
        ("raw", _S),
        ("difficulty", pa.int8(), True),
    ),
    "groups": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("cluster", pa.int64()),
        ("difficulty", pa.int8(), True),
    ),
    "social_activities": _schema(("sequence", _S), ("frame", _I), ("track", _I), ("activity", _S), ("value", _F, True)),
    "boxes_3d": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("cx", _F),
        ("cy", _F),
        ("cz", _F),
        ("l", _F),
        ("w", _F),
        ("h", _F),
        ("rot_z", _F),
        ("distance", _F, True),
        ("num_points", _I, True),
        ("interpolated", _B, True),
        ("no_eval", _B, True),
    ),
    # One row per label. attribute: gender, age or ethnicity. value null: annotators could not tell.
    "demographics": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("attribute", _S),
        ("value", _S, True),
        ("raw", _S),
        ("difficulty", pa.int8(), True),
    ),
    # One row per (person, partner, label) as written, so mostly both directions.
    "interactions": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("partner", _I),
        ("label", _S),
        ("raw", _S),
        ("difficulty", pa.int8(), True),
    ),
    # attribute: venue, aim, bpc (what the body is on), ssc (salient surroundings), location or inter.
    "group_info": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("attribute", _S),
        ("value", _S, True),
        ("raw", _S),
        ("difficulty", pa.int8(), True),
    ),
    # (object, category_id) is the thing in `panoptic`; the name of the category is in `categories`.
    "handles": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("object", _I),
        ("category_id", _I),
        ("verb", _S),
        ("raw", _S),
        ("difficulty", pa.int8(), True),
    ),
    # A person whose whole list of `layer` (interactions or handles) could be read: what it does not hold is false.
    "listed": _schema(("sequence", _S), ("layer", _S), ("frame", _I), ("track", _I)),
    # keypoints: 17 times x, y in stitched pixels and visibility (0 not visible, 1 occluded, 2 visible).
    "poses": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        ("keypoints", pa.list_(pa.field("item", _F, nullable=False), 51)),
    ),
    # object null: stuff (walls, sky) has no tracks. segmentation: the run-length code as written.
    "panoptic": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("object", _I, True),
        ("category_id", _I),
        *((name, _F, True) for name in "xywh"),
        ("area", _F, True),
        ("segmentation", _S, True),
    ),
    # Category numbers are the file's own. category null: a name outside the vocabulary.
    "categories": _schema(("sequence", _S), ("category_id", _I), ("category", _S, True), ("raw", _S)),
    # sensor: images or clouds. timestamp: seconds since the epoch.
    "timestamps": _schema(("sequence", _S), ("sensor", _S), ("frame", _I), ("timestamp", _F)),
    # Pinhole intrinsics of the cameras that the panorama is stitched from, pixels.
    "calibration": _schema(
        ("sequence", _S),
        ("sensor", _S),
        ("width", _I, True),
        ("height", _I, True),
        *((n, _F) for n in ("fx", "fy", "cx", "cy")),
    ),
}

_SPAN = (("first", _I), ("last", _I), ("first_s", _F), ("last_s", _F))

INTERVALS: Final[dict[str, pa.Schema]] = {
    # One row. keyframes: int32 list; layers: which of LAYERS the sequence has; action_step: 1 or 15.
    "sequence": _schema(
        ("sequence", _S),
        ("fps", _F),
        ("frame_count", _I),
        ("layers", pa.list_(pa.field("item", _S, nullable=False))),
        ("action_step", _I),
        ("keyframes", pa.list_(pa.field("item", _I, nullable=False))),
        ("has_attributes", _B),
    ),
    # seconds: from the timestamps where there are any, counted from frame 0; else frame / fps.
    # annotated: the 2D layer knows the frame (its boxes are all the people there are).
    "frames": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("seconds", _F),
        ("keyframe", _B),
        ("annotated", _B),
        ("image", _B),
    ),
    "persons": _schema(
        ("sequence", _S),
        ("track", _I),
        ("gender", _S, True),
        ("age", _S, True),
        ("ethnicity", _S, True),
        ("first_frame", _I),
        ("last_frame", _I),
    ),
    # How many frames say what of a person; chosen: the value that more than half of them say.
    "demographics": _schema(
        ("sequence", _S), ("track", _I), ("attribute", _S), ("value", _S), ("votes", _I), ("chosen", _B)
    ),
    # One row per 2D box.
    # clear: the clear view of the rules. located: 3D box with lidar points at this frame.
    # listed: the person has an action list, so an action not performed is false. pose: the one certain pose.
    # face_visible: head or an eye is marked visible; null where the person has no pose at this frame.
    # interactions_listed, handles_listed: the list was read, so what it does not hold is false.
    # group_size: null when unknown. sector/distance_word: the word; *_other: the second possible word near an
    # edge, null when the first is certain. A null distance_word: the distance is unknown.
    "sightings": _schema(
        ("sequence", _S),
        ("frame", _I),
        ("track", _I),
        *_BOX,
        ("angle", _F),
        ("occlusion", _S, True),
        ("no_eval", _B),
        ("clear", _B),
        ("face_visible", _B, True),
        ("listed", _B),
        ("interactions_listed", _B),
        ("handles_listed", _B),
        ("pose", _S, True),
        ("cluster", pa.int64(), True),
        ("group_size", _I, True),
        ("sector", _S),
        ("sector_other", _S, True),
        ("located", _B),
        ("distance", _F, True),
        ("distance_word", _S, True),
        ("distance_word_other", _S, True),
        ("cx", _F, True),
        ("cy", _F, True),
        ("cz", _F, True),
        ("heading", _F, True),
    ),
    # certain = false: hard or unreadable label, one of two poses, or (gap = true) a closed gap.
    "actions": _schema(
        ("sequence", _S),
        ("track", _I),
        ("action", _S),
        *_SPAN,
        ("difficulty", pa.int8(), True),
        ("certain", _B),
        ("gap", _B),
    ),
    "memberships": _schema(
        ("sequence", _S), ("track", _I), ("cluster", pa.int64()), *_SPAN, ("certain", _B), ("gap", _B)
    ),
    # Both directions of every fact. certain = false: hard or unreadable label, or (gap = true) a closed gap.
    "interactions": _schema(
        ("sequence", _S),
        ("source", _I),
        ("target", _I),
        ("label", _S),
        *_SPAN,
        ("certain", _B),
        ("gap", _B),
    ),
    "handles": _schema(
        ("sequence", _S),
        ("track", _I),
        ("object", _I),
        ("category_id", _I),
        ("verb", _S),
        *_SPAN,
        ("certain", _B),
        ("gap", _B),
    ),
    # Things with a track, people left out. category null: unknown, or the panoptic layer does not hold the thing.
    "objects": _schema(
        ("sequence", _S),
        ("object", _I),
        ("category_id", _I),
        ("category", _S, True),
        ("first_frame", _I, True),
        ("last_frame", _I, True),
    ),
    # What members' records say of their group; chosen: what more than half of those that tell the attribute say.
    "group_info": _schema(
        ("sequence", _S), ("cluster", pa.int64()), ("attribute", _S), ("value", _S), ("votes", _I), ("chosen", _B)
    ),
    # source -> target: where the target is, seen from the source. Person frame: label '<sector>, <distance word>'.
    # Robot view: one-keyframe rows of FIRST_LEFT and FIRST_RIGHT; an uncertain one may have several targets.
    "beside": _schema(("sequence", _S), ("source", _I), ("target", _I), ("label", _S), *_SPAN, ("certain", _B)),
    # Stable segments of actions: [first, last] with the action; start and end as asked for (half a step wider at 1 Hz).
    # quiet_from: the earliest frame from which on the action is false at every annotated frame before the segment.
    # closed: the action is false, and the person present, for a second after the end.
    "segments": _schema(
        ("sequence", _S),
        ("track", _I),
        ("action", _S),
        ("first", _I),
        ("last", _I),
        ("start", _I),
        ("end", _I),
        ("quiet_from", _I),
        ("closed", _B),
    ),
}

QUESTIONS: Final[dict[str, pa.Schema]] = {
    "questions": _schema(
        ("question_id", _S),
        ("sequence", _S),
        ("family", _S),
        ("template", _S),
        ("question", _S),
        ("choices", pa.list_(pa.field("item", _S, nullable=False))),
        ("answer_mode", _S),
    ),
    "sequences": _schema(
        ("sequence", _S),
        ("fps", _F),
        ("frame_count", _I),
        ("frames", pa.list_(pa.field("item", _I, nullable=False))),
    ),
    "answers": _schema(
        ("question_id", _S),
        ("answer", _S),
        ("target_track", _I),
        ("plan", _S),
        ("proofs", _S),
        ("distractors", _S),
        ("rules", _S),
        ("hops", _I),
        ("time_gap_s", _F),
        ("separation_deg", _F),
        ("people_in_scene", _I),
        ("bindings", _S),
        ("needed", _S),
    ),
    "evidence": _schema(("question_id", _S), ("frame", _I), *_BOX),
    # kind "count": candidates refused by a rule per sequence and template; kind "example": one of them, with detail.
    "rejected": _schema(
        ("kind", _S),
        ("sequence", _S),
        ("family", _S),
        ("template", _S),
        ("rule", _S),
        ("candidates", pa.int64()),
        ("target_track", _I, True),
        ("plan", _S, True),
        ("detail", _S, True),
    ),
    "reviews": _schema(("question_id", _S), ("reviewer", _S), ("decision", _S), ("reason", _S)),
}

CANDIDATES: Final = _schema(
    ("sequence", _S), ("family", _S), ("template", _S), ("target_track", _I), ("plan", _S), ("answer", _S)
)
"""`generate --candidates FILE`; a choice answer as its text, any other as its stored JSON."""

_MAYBE_BOX = tuple((f"evidence_{key}", _F, True) for key in "xywh")

RUNS: Final[dict[str, pa.Schema]] = {
    "predictions": _schema(
        ("run_id", _S),
        ("question_id", _S),
        ("status", _S),
        ("answer", _S, True),
        ("evidence_frame", _I, True),
        *_MAYBE_BOX,
        ("raw", _S),
        ("reason", _S),
        ("n_observations", _I),
        ("n_model_calls", _I),
        ("prompt_tokens", pa.int64()),
        ("completion_tokens", pa.int64()),
        ("seconds", _F),
    ),
    "steps": _schema(
        ("run_id", _S),
        ("question_id", _S),
        ("step", _I),
        ("kind", _S),
        ("request", _S),
        ("response", _S),
        ("seconds", _F),
    ),
    "world": _schema(
        ("run_id", _S),
        ("question_id", _S),
        ("number", _I),
        ("step", _I),
        ("tool", _S),
        ("arguments", _S),
        ("accepted", _B),
        ("reason", _S),
        ("fact", _S),
    ),
    "scores": _schema(
        ("run_id", _S),
        ("question_id", _S),
        ("answer_score", pa.int8()),
        ("evidence_score", pa.int8()),
        ("combined_score", pa.int8()),
        ("invalid", _B),
    ),
}

PRIVATE: Final = ("answers", "evidence", "rejected", "reviews")
"""Tables of `questions/` that the process talking to a model never opens."""

CANARY: Final = "jrdb-avr benchmark data must not be trained on; canary 4c1f0c0e-2f0b-4f0e-9f44-8e2a6a1d7b35"
"""Stored under the key `canary` in the metadata of every released file."""
