"""The seventeen joints of a figure: where its body is, for the pictures and for the pose labels alike.

A joint is given in the body's own frame as (forward, left, down): the first two in widths of the box, the last from 0
(top of the box) to 1 (feet). The camera sees forward and left as one coordinate across, by the way the person faces.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from jrdb_avr.schema.arrays import Floats, Ints
from jrdb_avr.schema.labels import OTHER_ACTIONS, POSES

JOINTS: Final = (
    "head",
    "right eye",
    "left eye",
    "right shoulder",
    "center shoulder",
    "left shoulder",
    "right elbow",
    "left elbow",
    "center hip",
    "right wrist",
    "right hip",
    "left hip",
    "left wrist",
    "right knee",
    "left knee",
    "right foot",
    "left foot",
)
HEAD, R_EYE, L_EYE, R_SHOULDER, NECK, L_SHOULDER, R_ELBOW, L_ELBOW, HIP = range(9)
R_WRIST, R_HIP, L_HIP, L_WRIST, R_KNEE, L_KNEE, R_FOOT, L_FOOT = range(9, 17)
RIGHT_SIDE: Final = (R_EYE, R_SHOULDER, R_ELBOW, R_WRIST, R_HIP, R_KNEE, R_FOOT)
LEFT_SIDE: Final = (L_EYE, L_SHOULDER, L_ELBOW, L_WRIST, L_HIP, L_KNEE, L_FOOT)

Triple = tuple[float, float, float]


def _body(head: Triple, neck: Triple, middle: Triple, **pairs: Triple) -> Floats:
    """(17, 3): head, neck, middle of the hips, and pairs, given for the left side and mirrored for the right.

    Eyes lie before the head.
    """
    out = np.zeros((17, 3))
    out[HEAD], out[NECK], out[HIP] = head, neck, middle
    eye = (head[0] + 0.08, head[1] + 0.04, head[2] - 0.01)
    pair = {"eye": eye, **pairs}
    for name, (forward, left, down) in pair.items():
        out[JOINTS.index(f"left {name}")] = forward, left, down
        out[JOINTS.index(f"right {name}")] = forward, -left, down
    return out


_UPRIGHT: Final = _body(
    (0, 0, 0.085),
    (0, 0, 0.175),
    (0, 0, 0.52),
    shoulder=(0, 0.25, 0.20),
    elbow=(0, 0.31, 0.36),
    wrist=(0.03, 0.32, 0.51),
    hip=(0, 0.13, 0.53),
    knee=(0, 0.13, 0.75),
    foot=(0, 0.13, 0.97),
)
_SITTING: Final = _body(
    (0, 0, 0.115),
    (-0.04, 0, 0.23),
    (-0.12, 0, 0.62),
    shoulder=(-0.04, 0.23, 0.27),
    elbow=(0.04, 0.28, 0.45),
    wrist=(0.2, 0.2, 0.56),
    hip=(-0.12, 0.12, 0.62),
    knee=(0.27, 0.12, 0.64),
    foot=(0.29, 0.12, 0.97),
)
_BENDING: Final = _body(
    (0.36, 0, 0.30),
    (0.22, 0, 0.27),
    (-0.18, 0, 0.31),
    shoulder=(0.2, 0.17, 0.28),
    elbow=(0.27, 0.18, 0.5),
    wrist=(0.32, 0.16, 0.76),
    hip=(-0.18, 0.12, 0.32),
    knee=(-0.15, 0.12, 0.64),
    foot=(-0.12, 0.12, 0.97),
)
_LYING: Final = _body(
    (0.38, 0, 0.45),
    (0.27, 0, 0.5),
    (-0.08, 0, 0.58),
    shoulder=(0.25, 0.12, 0.52),
    elbow=(0.13, 0.13, 0.62),
    wrist=(0.0, 0.13, 0.66),
    hip=(-0.08, 0.1, 0.58),
    knee=(-0.28, 0.1, 0.63),
    foot=(-0.46, 0.1, 0.66),
)
_CYCLING: Final = _body(
    (0.1, 0, 0.09),
    (0.06, 0, 0.19),
    (-0.12, 0, 0.52),
    shoulder=(0.06, 0.14, 0.22),
    elbow=(0.14, 0.16, 0.35),
    wrist=(0.24, 0.14, 0.46),
    hip=(-0.12, 0.1, 0.53),
    knee=(0.1, 0.1, 0.64),
    foot=(0.0, 0.1, 0.84),
)
_SCOOTERING: Final = _body(
    (0.06, 0, 0.085),
    (0.05, 0, 0.17),
    (0, 0, 0.52),
    shoulder=(0.05, 0.2, 0.2),
    elbow=(0.18, 0.2, 0.33),
    wrist=(0.36, 0.12, 0.42),
    hip=(0, 0.12, 0.53),
    knee=(0.02, 0.13, 0.74),
    foot=(0.0, 0.14, 0.93),
)
_SKATING: Final = _body(
    (0.05, 0, 0.085),
    (0.05, 0, 0.17),
    (0, 0, 0.52),
    shoulder=(0.05, 0.25, 0.2),
    elbow=(0.0, 0.36, 0.32),
    wrist=(0.02, 0.42, 0.4),
    hip=(0, 0.12, 0.53),
    knee=(0.02, 0.13, 0.74),
    foot=(0.0, 0.14, 0.93),
)
_BODIES: Final = np.stack(
    [
        {
            "sitting": _SITTING,
            "bending": _BENDING,
            "lying": _LYING,
            "cycling": _CYCLING,
            "scootering": _SCOOTERING,
            "skating": _SKATING,
        }.get(name, _UPRIGHT)
        for name in POSES
    ]
)

_LEAST_SIDE: Final = np.array(
    [{"sitting": 0.5, "bending": 0.85, "lying": 1.0, "cycling": 1.0, "scootering": 0.8}.get(n, 0.35) for n in POSES]
)
"""How far across a pose is always drawn, so that it can be told from others also when seen from the front."""
_SWING: Final = np.array(
    [{"walking": 0.20, "running": 0.30, "going upstairs": 0.18, "going downstairs": 0.18}.get(n, 0.0) for n in POSES]
)

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


def facing(pose: Ints, side: Floats, toward: Floats) -> tuple[Floats, Floats]:
    """How far across (-1 left, 1 right) and how far toward the robot (1 front, -1 back) a figure is drawn."""
    across = np.where(side < 0, -1.0, 1.0) * np.maximum(np.abs(side), _LEAST_SIDE[pose])
    depth = np.sqrt(np.maximum(0.0, 1.0 - across**2))
    return across, np.where(toward < 0, -depth, depth)


def joints(pose: Ints, actions: Ints, side: Floats, toward: Floats, stride: Floats) -> Floats:
    """Joints (n, 17, 2) of n figures inside their boxes: across from -0.5 to 0.5, down from 0 to 1.

    `pose` (n) and `actions` (n, 2) are places in the vocabularies, negative for none; `side` and `toward` (n) say how
    the person faces (1, 0: to the right of the picture; 0, 1: the robot); `stride` (n) is the phase of its gait.
    """
    body = _BODIES[pose].copy()
    arms = ((R_ELBOW, R_WRIST, -1.0), (L_ELBOW, L_WRIST, 1.0))
    raised = np.zeros((len(pose), 2), bool)
    for slot in range(2):
        action = actions[:, slot]
        which = (action >= 0) & _MOVES_ARM[action] & _FREE_ARMS[pose]
        elbow, wrist, mirror = arms[slot]
        body[which, elbow] = _ARMS[action[which], 0] * (1.0, mirror, 1.0)
        body[which, wrist] = _ARMS[action[which], 1] * (1.0, mirror, 1.0)
        raised[:, slot] = which
    # Who sits has the head lower in the box, and so the arms.
    seated = pose == POSES.index("sitting")
    for slot, (elbow, wrist, _) in enumerate(arms):
        lower = seated & raised[:, slot]
        body[lower, elbow, 2] += 0.07
        body[lower, wrist, 2] += 0.07
    swing = _SWING[pose] * np.sin(stride)
    lift = np.abs(_SWING[pose]) * np.cos(stride)
    for knee, foot, sign in ((R_KNEE, R_FOOT, 1.0), (L_KNEE, L_FOOT, -1.0)):
        body[:, knee, 0] += 0.6 * sign * swing
        body[:, foot, 0] += sign * swing
        body[:, knee, 2] -= 0.1 * np.maximum(0.0, sign * lift)
        body[:, foot, 2] -= 0.25 * np.maximum(0.0, sign * lift)
    _ride(body, pose, stride)
    across, depth = facing(pose, side, toward)
    u = body[..., 0] * across[:, None] + body[..., 1] * depth[:, None]
    return np.stack([np.clip(u, -0.49, 0.49), np.clip(body[..., 2], 0.01, 0.99)], axis=-1)


def _ride(body: Floats, pose: Ints, stride: Floats) -> None:
    """Pedals go round; feet stand one before the other on a board."""
    for name in ("cycling", "skating", "scootering"):
        which = pose == POSES.index(name)
        for knee, foot, sign in ((R_KNEE, R_FOOT, 1.0), (L_KNEE, L_FOOT, -1.0)):
            if name == "cycling":
                body[which, foot, 0] += 0.06 * sign * np.cos(stride[which])
                body[which, foot, 2] += 0.06 * sign * np.sin(stride[which])
                body[which, knee, 2] += 0.036 * sign * np.sin(stride[which])
            else:
                body[which, foot, 0] += 0.16 * sign
                body[which, knee, 0] += 0.14 * sign
