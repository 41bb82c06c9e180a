"""Place the seventeen joints of a figure, for the pictures and for the pose labels.

A joint lies in the body's own frame as (forward, left, down): the first two in widths of the box, the last from 0
(top of the box) to 1 (feet). The camera sees forward and left as one coordinate across, by the way the person faces.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from jrdb_avr.schema.arrays import Floats, Ints
from jrdb_avr.schema.labels import OTHER_ACTIONS, POSES

JOINTS: Final = (
    *("head", "right eye", "left eye", "right shoulder", "center shoulder", "left shoulder", "right elbow"),
    *("left elbow", "center hip", "right wrist", "right hip", "left hip", "left wrist", "right knee", "left knee"),
    *("right foot", "left foot"),
)
HEAD, R_EYE, L_EYE, R_SHOULDER, NECK, L_SHOULDER, R_ELBOW, L_ELBOW, HIP = range(9)
R_WRIST, R_HIP, L_HIP, L_WRIST, R_KNEE, L_KNEE, R_FOOT, L_FOOT = range(9, 17)
RIGHT_SIDE: Final = (R_EYE, R_SHOULDER, R_ELBOW, R_WRIST, R_HIP, R_KNEE, R_FOOT)
LEFT_SIDE: Final = (L_EYE, L_SHOULDER, L_ELBOW, L_WRIST, L_HIP, L_KNEE, L_FOOT)
_LEGS: Final = ((R_KNEE, R_FOOT, 1.0), (L_KNEE, L_FOOT, -1.0))
"""Knee, foot, and the sign of their part in a step."""

_ARM_JOINTS: Final = ((R_ELBOW, R_WRIST, -1.0), (L_ELBOW, L_WRIST, 1.0))
"""Elbow, wrist, and the sign of their direction to the left. The first action uses the right arm."""

_BODIES_OF: Final = {
    # head, neck and middle of the hips; then the left shoulder, elbow, wrist, hip, knee and foot
    "standing": (
        (0, 0, 0, 0, 0, 0.03, 0, 0, 0),
        (0, 0, 0, 0.25, 0.31, 0.32, 0.13, 0.13, 0.13),
        (0.085, 0.175, 0.52, 0.20, 0.36, 0.51, 0.53, 0.75, 0.97),
    ),
    "sitting": (
        (0, -0.04, -0.12, -0.04, 0.04, 0.2, -0.12, 0.27, 0.29),
        (0, 0, 0, 0.23, 0.28, 0.2, 0.12, 0.12, 0.12),
        (0.115, 0.23, 0.62, 0.27, 0.45, 0.56, 0.62, 0.64, 0.97),
    ),
    "bending": (
        (0.36, 0.22, -0.18, 0.2, 0.27, 0.32, -0.18, -0.15, -0.12),
        (0, 0, 0, 0.17, 0.18, 0.16, 0.12, 0.12, 0.12),
        (0.30, 0.27, 0.31, 0.28, 0.5, 0.76, 0.32, 0.64, 0.97),
    ),
    "lying": (
        (0.38, 0.27, -0.08, 0.25, 0.13, 0.0, -0.08, -0.28, -0.46),
        (0, 0, 0, 0.12, 0.13, 0.13, 0.1, 0.1, 0.1),
        (0.45, 0.5, 0.58, 0.52, 0.62, 0.66, 0.58, 0.63, 0.66),
    ),
    "cycling": (
        (0.1, 0.06, -0.12, 0.06, 0.14, 0.24, -0.12, 0.1, 0.0),
        (0, 0, 0, 0.14, 0.16, 0.14, 0.1, 0.1, 0.1),
        (0.09, 0.19, 0.52, 0.22, 0.35, 0.46, 0.53, 0.64, 0.84),
    ),
    "scootering": (
        (0.06, 0.05, 0, 0.05, 0.18, 0.36, 0, 0.02, 0.0),
        (0, 0, 0, 0.2, 0.2, 0.12, 0.12, 0.13, 0.14),
        (0.085, 0.17, 0.52, 0.2, 0.33, 0.42, 0.53, 0.74, 0.93),
    ),
    "skating": (
        (0.05, 0.05, 0, 0.05, 0.0, 0.02, 0, 0.02, 0.0),
        (0, 0, 0, 0.25, 0.36, 0.42, 0.12, 0.13, 0.14),
        (0.085, 0.17, 0.52, 0.2, 0.32, 0.4, 0.53, 0.74, 0.93),
    ),
}
"""Forward, left and down offsets of joints by pose. All other poses are upright as in standing."""
AWAY: Final = -0.25
"""Minimum turn from the robot if a person hides the face and the held things."""


def _body(pose: str) -> Floats:
    """Return the joints of a pose, (17, 3). The right side mirrors the left, and the eyes are before the head."""
    rows = np.array(_BODIES_OF.get(pose, _BODIES_OF["standing"])).T
    out = np.zeros((len(JOINTS), 3))
    out[[HEAD, NECK, HIP]], out[list(LEFT_SIDE[1:])] = rows[:3], rows[3:]
    out[L_EYE] = rows[0] + (0.08, 0.04, -0.01)
    out[list(RIGHT_SIDE)] = out[list(LEFT_SIDE)] * (1, -1, 1)
    return out


def _per_pose(values: dict[str, float], opposite: float) -> Floats:
    return np.array([values.get(name, opposite) for name in POSES])


_BODIES: Final = np.stack([_body(name) for name in POSES])
_LEAST_SIDE: Final = _per_pose({"sitting": 0.5, "bending": 0.85, "lying": 1.0, "cycling": 1.0, "scootering": 0.8}, 0.35)
"""Minimum offset across of a drawn pose, so that poses differ also if seen from the front."""
_SWING: Final = _per_pose({"walking": 0.20, "running": 0.30, "going upstairs": 0.18, "going downstairs": 0.18}, 0.0)
_PEDAL: Final = _per_pose({"cycling": 0.06}, 0.0)
"""Radius of the circle of a foot's motion."""
_STANCE: Final = _per_pose({"skating": 0.16, "scootering": 0.16}, 0.0)
"""Distance of a foot on a board from the middle."""

_REACH: Final = {
    "pointing at sth": ((0.24, 0.3, 0.22), (0.44, 0.2, 0.2)),
    "greeting gestures": ((0.06, 0.40, 0.19), (0.1, 0.40, 0.05)),
    "talking on the phone": ((0.1, 0.38, 0.30), (0.07, 0.15, 0.10)),
    "holding sth": ((0.06, 0.33, 0.37), (0.3, 0.3, 0.43)),
    "typing": ((0.1, 0.3, 0.38), (0.36, 0.12, 0.42)),
    "eating sth": ((0.14, 0.33, 0.34), (0.22, 0.1, 0.2)),
    "reading": ((0.12, 0.32, 0.36), (0.34, 0.1, 0.34)),
    "writing": ((0.12, 0.32, 0.38), (0.36, 0.2, 0.40)),
    "looking into sth": ((0.12, 0.32, 0.38), (0.34, 0.16, 0.38)),
    "pushing": ((0.16, 0.26, 0.36), (0.4, 0.2, 0.42)),
    "pulling": ((-0.16, 0.3, 0.36), (-0.38, 0.24, 0.5)),
    "interaction with door": ((0.2, 0.3, 0.3), (0.42, 0.24, 0.36)),
}
_ARMS: Final = np.array([_REACH.get(name, ((0.0, 0.0, 0.0),) * 2) for name in OTHER_ACTIONS])
_MOVES_ARM: Final = np.array([name in _REACH for name in OTHER_ACTIONS])
_FREE_ARMS: Final = np.array([name not in ("bending", "lying", "cycling", "scootering") for name in POSES])


def joints(pose: Ints, actions: Ints, side: Floats, toward: Floats, stride: Floats) -> Floats:
    """Return joints (n, 17, 2) of n figures in their boxes: across from -0.5 to 0.5, down from 0 to 1.

    `pose` (n) and `actions` (n, 2) are places in the vocabularies, negative for none; `side` and `toward` (n) are how
    the person faces (1, 0: to the right of the picture; 0, 1: the robot); `stride` (n) is the phase of its gait.
    """
    body = _BODIES[pose].copy()
    # Who sits has the head lower in the box, and so the arms.
    lower = np.where(pose == POSES.index("sitting"), 0.07, 0.0)
    for action, (elbow, wrist, mirror) in zip(actions.T, _ARM_JOINTS, strict=True):
        which = np.flatnonzero((action >= 0) & _MOVES_ARM[action] & _FREE_ARMS[pose])
        arm = _ARMS[action[which]] * (1.0, mirror, 1.0)
        arm[..., 2] += lower[which, None]
        body[which[:, None], [elbow, wrist]] = arm
    swing, lift = _SWING[pose] * np.sin(stride), _SWING[pose] * np.cos(stride)
    pedal, stance = _PEDAL[pose], _STANCE[pose]
    for knee, foot, sign in _LEGS:
        body[:, knee, 0] += sign * (0.6 * swing + 0.875 * stance)
        body[:, foot, 0] += sign * (swing + pedal * np.cos(stride) + stance)
        body[:, knee, 2] += sign * 0.6 * pedal * np.sin(stride) - 0.1 * np.maximum(0.0, sign * lift)
        body[:, foot, 2] += sign * pedal * np.sin(stride) - 0.25 * np.maximum(0.0, sign * lift)
    across = np.where(side < 0, -1.0, 1.0) * np.maximum(np.abs(side), _LEAST_SIDE[pose])
    depth = np.where(toward < 0, -1.0, 1.0) * np.sqrt(np.maximum(0.0, 1.0 - across**2))
    u = body[..., 0] * across[:, None] + body[..., 1] * depth[:, None]
    return np.stack([np.clip(u, -0.49, 0.49), np.clip(body[..., 2], 0.01, 0.99)], axis=-1)
