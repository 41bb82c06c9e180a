"""Small JRDB roots written from plain dicts, for tests that need a world they can see through.

    world = {"yard-2020-01-01_0": {"2d": {0: [person(1, (100, 60, 50, 200), {"walking": 1})], 15: []}}}
    root = write_root(tmp_path / "root", world)
    store = load_world(tmp_path, world)

A world is {sequence: {layer: {frame: [records]}}} with the layers `2d` and `3d`, and `images`, a list of frame numbers
that get a grey panorama. A layer may also be given as text or bytes, which are written as they are: broken files.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

VISIBLE = {"interpolated": False, "no_eval": False, "occlusion": "Fully_visible", "truncated": "false"}
FOLDERS = {"2d": ("labels_2d_stitched", "jpg"), "3d": ("labels_3d", "pcd")}


def person(track, box, actions=None, group=None, attributes=VISIBLE, **more):
    """A 2D record. `group` is (cluster, difficulty); None leaves a key out, and so does `attributes=None`."""
    record = {"label_id": f"pedestrian:{track}", "box": list(box)}
    if attributes is not None:
        record["attributes"] = {"area": float(box[2] * box[3]), **attributes}
    if actions is not None:
        record["action_label"] = actions
    if group is not None:
        record["social_group"] = {"cluster_ID": group[0], "cluster_stat": group[1]}
    return record | more


def person_3d(track, x, y, z=0.0, heading=0.0, points=100, distance=None, **more):
    """A 3D record. `heading` in radians counter-clockwise from straight ahead of the robot; rot_z follows from it."""
    attributes = {"num_points": points, "interpolated": True, "no_eval": False, "distance": distance}
    box = {"cx": x, "cy": y, "cz": z, "l": 0.6, "w": 0.5, "h": 1.7, "rot_z": math.pi - heading}
    return {"label_id": f"pedestrian:{track}", "box": box, "attributes": attributes} | more


def write_root(root, world, labels_level=True):
    """Write a world as a JRDB root, with or without the `labels/` level; returns the root."""
    base = Path(root) / "labels" if labels_level else Path(root)
    Path(root).mkdir(parents=True, exist_ok=True)
    for sequence, layers in world.items():
        for layer, content in layers.items():
            if layer == "images":
                _write_images(Path(root), sequence, content)
                continue
            folder, suffix = FOLDERS[layer]
            (base / folder).mkdir(parents=True, exist_ok=True)
            (base / folder / f"{sequence}.json").write_bytes(as_bytes(content, suffix))
    return Path(root)


def as_bytes(content, suffix):
    """A layer's file; text and bytes are taken as they are."""
    if isinstance(content, bytes):
        return content
    if isinstance(content, str):
        return content.encode()
    frames = {frame if isinstance(frame, str) else f"{frame:06d}.{suffix}": rows for frame, rows in content.items()}
    return json.dumps({"labels": frames}).encode()


def load_world(folder, world, workers=1, rules=None):
    """Write a world, load it into a store and return the store; both lie in `folder`."""
    store, _ = load_reported(folder, world, workers, rules)
    return store


def load_reported(folder, world, workers=1, rules=None):
    """As `load_world`, with the load reports beside the store."""
    from jrdb_avr.loaders.layers import find_root
    from jrdb_avr.loaders.load import load
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import LoadRules

    root = write_root(Path(folder) / "root", world)
    store = Store(Path(folder) / "store")
    return store, load(find_root(root), store, rules or LoadRules(), workers)


def _write_images(root, sequence, frames):
    import cv2
    import numpy as np

    folder = root / "images" / "image_stitched" / sequence
    folder.mkdir(parents=True, exist_ok=True)
    grey = cv2.imencode(".jpg", np.full((480, 3760, 3), 128, np.uint8))[1].tobytes()
    for frame in frames:
        (folder / f"{frame:06d}.jpg").write_bytes(grey)
