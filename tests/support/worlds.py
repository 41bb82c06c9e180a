"""Small JRDB roots written from plain dicts, for tests that need a world they can see through.

    world = {"yard-2020-01-01_0": {"2d": {0: [person(1, (100, 60, 50, 200), {"walking": 1})], 15: []}}}
    root = write_root(tmp_path / "root", world)
    store = load_world(tmp_path, world)

A world is {sequence: {layer: content}}. Layers:
- `2d`, `social`, `reasoning` and `3d`: {frame: [records]}, made with `person`, `member` and `person_3d`;
- `pose` and `panoptic`: {frame: [annotations]}, made with `pose` and `thing`; or a COCO dict, written as it is;
- `timestamps`: {"images": {frame: seconds}, "clouds": {frame: seconds}}, either or both;
- `calibration`: the text of `cameras.yaml`, which belongs to all sequences;
- `images`: a list of frame numbers that get a grey panorama.
A layer may also be given as text or bytes, which are written as they are: broken files.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

VISIBLE = {"interpolated": False, "no_eval": False, "occlusion": "Fully_visible", "truncated": "false"}
FOLDERS = {
    "2d": "labels_2d_stitched",
    "3d": "labels_3d",
    "social": "labels_2d_activity_social_stitched",
    "reasoning": "labels_2d_stitched_new_version",
    "pose": "labels_2d_pose_stitched_coco",
    "panoptic": "labels_2d_panoptic_stitched_CW",
}
STAMPS = {"images": ("frames_img.json", "cameras", "stitched"), "clouds": ("frames_pc.json", "pointclouds", "velodyne")}
CATEGORIES = {40: "accessory", 57: "shelf", 63: "pedestrian", 4: "wall", 71: "door", 900: "teapot"}
"""Numbers of a file of its own: not all are those of the standard list."""
CAMERAS = """cameras:
  sensor_0:
    width: 752
    height: 480
    K: >
      476.7 0 350.7
      0 479.5 209.5
      0 0 1
"""


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


def member(
    track, box, demographics=None, interactions=None, info=None, handles=None, group=None, alias="H-interaction"
):
    """A social or reasoning record. None leaves a key out.

    `demographics` and `info` are the one object of their list, or the list; `interactions` [(partner, labels)];
    `handles` [((object, category), verbs)]; `alias` is the key that interactions stand under.
    """
    more = {}
    if demographics is not None:
        more["demographics_info"] = [demographics] if isinstance(demographics, dict) else demographics
    if interactions is not None:
        more[alias] = [
            {"pair": p if isinstance(p, str) else f"pedestrian:{p}", "box_pair": [1, 2, 3, 4], "inter_labels": labels}
            for p, labels in interactions
        ]
    if info is not None:
        more["group_info"] = [info] if isinstance(info, dict) else info
    if handles is not None:
        more["HOI"] = [{"inter_labels": verbs, "pair": list(pair)} for pair, verbs in handles]
    return person(track, box, group=group, **more)


def person_3d(track, x, y, z=0.0, heading=0.0, points=100, distance=None, **more):
    """A 3D record. `heading` in radians counter-clockwise from straight ahead of the robot; rot_z follows from it."""
    attributes = {"num_points": points, "interpolated": True, "no_eval": False, "distance": distance}
    box = {"cx": x, "cy": y, "cz": z, "l": 0.6, "w": 0.5, "h": 1.7, "rot_z": math.pi - heading}
    return {"label_id": f"pedestrian:{track}", "box": box, "attributes": attributes} | more


def pose(track, x=100.0, y=100.0, visibility=2, **more):
    """A COCO keypoint annotation. `visibility` is one code for all 17 points, or one per point."""
    codes = [visibility] * 17 if isinstance(visibility, int) else list(visibility)
    keypoints = [value for i, code in enumerate(codes) for value in (x + i, y + 5 * i, code)]
    visible = sum(code > 0 for code in codes)
    return {"track_id": track, "category_id": 1, "keypoints": keypoints, "num_keypoints": visible} | more


def thing(track, category, box=(10, 20, 30, 40), where="tracking_id", **more):
    """A panoptic annotation. `where`: the key of the track, or "attributes.<key>"; `track` None is stuff."""
    record = {
        "category_id": category,
        "segmentation": {"size": [480, 3760], "counts": "abc"},
        "area": 12.5,
        "bbox": list(box),
    }
    outer, _, inner = where.partition(".")
    if track is not None:
        record[outer] = {inner: track} if inner else track
    return record | more


def write_root(root, world, labels_level=True, folders=FOLDERS):
    """Write a world as a JRDB root, with or without the `labels/` level; returns the root."""
    root = Path(root)
    base = root / "labels" if labels_level else root
    root.mkdir(parents=True, exist_ok=True)
    for sequence, layers in world.items():
        for layer, content in layers.items():
            if layer == "images":
                _write_images(root, sequence, content)
            elif layer == "timestamps":
                (root / "timestamps" / sequence).mkdir(parents=True, exist_ok=True)
                for sensor, stamps in content.items():
                    (root / "timestamps" / sequence / STAMPS[sensor][0]).write_bytes(as_bytes(stamps, sensor))
            elif layer == "calibration":
                (root / "calibration").mkdir(parents=True, exist_ok=True)
                (root / "calibration" / "cameras.yaml").write_bytes(as_bytes(content, layer))
            else:
                (base / folders[layer]).mkdir(parents=True, exist_ok=True)
                (base / folders[layer] / f"{sequence}.json").write_bytes(as_bytes(content, layer))
    return root


def as_bytes(content, layer):
    """A layer's file; text and bytes are taken as they are. `layer` is `images` or `clouds` for timestamps."""
    if isinstance(content, bytes):
        return content
    if isinstance(content, str):
        return content.encode()
    if layer in STAMPS:
        return json.dumps(stamps_file(content, layer)).encode()
    if layer in ("pose", "panoptic"):
        return json.dumps(content if "images" in content else coco_file(content, layer)).encode()
    suffix = "pcd" if layer == "3d" else "jpg"
    frames = {frame if isinstance(frame, str) else f"{frame:06d}.{suffix}": rows for frame, rows in content.items()}
    return json.dumps({"labels": frames}).encode()


def coco_file(frames, layer):
    """{frame: [annotations]} as a COCO dict. Image numbers are no frame numbers: whoever reads must join by name."""
    categories = {1: "person"} if layer == "pose" else CATEGORIES
    names = {frame: f"image_stitched/yard/{frame:06d}.jpg" for frame in frames}
    images = [{"id": 1000 + 7 * i, "width": 752, "height": 480, "file_name": names[f]} for i, f in enumerate(frames)]
    annotations = [{"image_id": 1000 + 7 * i} | row for i, rows in enumerate(frames.values()) for row in rows]
    return {
        "categories": [{"id": number, "name": name} for number, name in categories.items()],
        "images": images,
        "annotations": [{"id": i} | row for i, row in enumerate(annotations, 1)],
    }


def stamps_file(stamps, sensor):
    """{frame: seconds} as a file of timestamps."""
    _, key, name = STAMPS[sensor]
    suffix = "jpg" if sensor == "images" else "pcd"
    return {
        "data": [
            {"frame_id": f, "timestamp": t, key: [{"name": name, "url": f"x/{f:06d}.{suffix}", "timestamp": t}]}
            for f, t in stamps.items()
        ]
    }


def load_world(folder, world, workers=1, rules=None):
    """Write a world, load it into a store and return the store; both lie in `folder`."""
    store, _ = load_reported(folder, world, workers, rules)
    return store


def load_reported(folder, world, workers=1, rules=None):
    """As `load_world`, with the load reports beside the store."""
    from jrdb_avr.loaders.load import load
    from jrdb_avr.loaders.root import find_root
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import LoadRules

    root = write_root(Path(folder) / "root", world)
    store = Store(Path(folder) / "store")
    return store, load(find_root(root), store, rules or LoadRules(), workers).reports


def _write_images(root, sequence, frames):
    import cv2
    import numpy as np

    folder = root / "images" / "image_stitched" / sequence
    folder.mkdir(parents=True, exist_ok=True)
    grey = cv2.imencode(".jpg", np.full((480, 3760, 3), 128, np.uint8))[1].tobytes()
    for frame in frames:
        (folder / f"{frame:06d}.jpg").write_bytes(grey)
