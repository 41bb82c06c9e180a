"""Label files as records that can be changed one by one, and the changes: of any kind, or into something unreadable."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import msgspec
from mutate import KEYS, TEXTS, mutate, places_of

BY_FRAME = ("2d", "3d", "social", "reasoning")
COCO = ("pose", "panoptic")


@dataclass(frozen=True)
class Group:
    """Records that stand in one list of a file, between `head` and `tail`; each with its frame, None for none."""

    head: bytes
    records: list[tuple[int | None, bytes]]
    tail: bytes = b"]"


@dataclass(frozen=True)
class LabelFile:
    """One file of a layer. Its text is the groups, comma by comma, between `head` and `tail`."""

    layer: str
    path: Path
    head: bytes
    groups: list[Group]
    tail: bytes

    def text(self, changes):
        """The text with {(group, record): bytes}; the record None stands for the whole group."""
        parts = []
        for g, group in enumerate(self.groups):
            if (g, None) in changes:
                parts.append(changes[g, None])
                continue
            rows = b",".join(changes.get((g, r), raw) for r, (_, raw) in enumerate(group.records))
            parts.append(group.head + rows + group.tail)
        return self.head + b",".join(parts) + self.tail


def read_label_file(layer, path):
    """A clean file as its records."""
    if layer == "calibration":
        return LabelFile(layer, path, b"", [Group(b"", [(None, path.read_bytes())], b"")], b"")
    content = json.loads(path.read_bytes())
    if layer in BY_FRAME:
        groups = [
            Group(b'"%b":[' % key.encode(), [(int(key[:6]), _raw(record)) for record in _once(records, "label_id")])
            for key, records in content["labels"].items()
        ]
        return LabelFile(layer, path, b'{"labels":{', groups, b"}}")
    if layer in COCO:
        frames = {image["id"]: int(Path(image["file_name"]).stem) for image in content["images"]}
        numbers = {"images": lambda row: frames[row["id"]], "annotations": lambda row: frames[row["image_id"]]}
        groups = [
            Group(
                b'"%b":[' % name.encode(),
                [(numbers.get(name, lambda row: None)(row), _raw(row)) for row in _once(rows, *_SAME)],
            )
            for name, rows in content.items()
        ]
        return LabelFile(layer, path, b"{", groups, b"}")
    rows = [(row["frame_id"], _raw(row)) for row in content["data"]]
    return LabelFile(layer, path, b"{", [Group(b'"data":[', rows)], b"}")


_SAME = ("file_name", "name", "image_id", "track_id", "tracking_id", "attributes", "category_id")


def _once(records, *names):
    """The records without repetitions: of two records of a person in a frame the loaders take the first, and where that
    one cannot be read they take the other."""
    first = {}
    for record in records:
        first.setdefault(json.dumps([record.get(name) for name in names]), record)
    return list(first.values())


def _raw(value):
    return json.dumps(value, separators=(",", ":")).encode()


def stays_apart(raw):
    """Whether a file stays readable in its other records when `raw` replaces one of them."""
    try:
        raw.decode()
        return bool(msgspec.json.decode(b"[" + raw + b"]", type=list[msgspec.Raw]))
    except (UnicodeError, RecursionError, msgspec.DecodeError):
        return False


# -- any change ----------------------------------------------------------------------------------------------------

_LABELS = [{}, {"conversation": "9"}, {"standing together together": "1"}, {"walking together": 1, "hugging": "2"}]
AWKWARD = {
    "label_id": ["pedestrian:0", "person:-1", "pedestrian:1e3", "car:3", "pedestrian: 4", "", "bag:1"],
    "box": [[-100, 0, 50, 50], [3700, 10, 200, 100], [0, 0, 0, 0], [1, 2, 3], {"x": 1}, [1e9, 0, 1, 1]],
    "truncated": ["true", True, None, "True", "no", 1],
    "occlusion": ["Fully_visible", "fully visible", None, "", 3, "Fully_occluded"],
    "no_eval": [True, "true", None, "x", 0],
    "cluster_ID": ["7", 7.0, -1, 2**62, 2**70, 0.5, None, True],
    "cluster_stat": ["1", 1.0, 0, 4, "easy", None],
    "action_label": [{}, None, {"impossible": 1}, {"walking": 1, "standing": 2}, {"opening the door": "1.0"}, []],
    "social_activity": [{"sitting": "x"}, {"": 1}],
    "social_group": [None, {}, [], {"cluster_ID": 3}],
    "rot_z": [1e9, -7.5, None, "0"],
    "num_points": [0, -1, 1.5, 2**31, None],
    "distance": [None, -1, "2", 1e5, 0],
    "demographics_info": [[], None, {}, [{}, {}], [{"gender": {"impossible": "1"}}], [{"age": {"Elder": "1"}}]],
    "H-interaction": [[], None, {}, [None], [{"pair": "pedestrian:1"}]],
    "HHI": [[], None, {}, [{"inter_labels": {"hugging": "1"}}]],
    "HOI": [[], None, [{"inter_labels": {"looking into": "1"}, "pair": [12, "17"]}], [{"pair": [1, 2, 3]}]],
    "pair": ["pedestrian:999", 5, [1, "2"], ["x", "y"], None, [-1, -1]],
    "inter_labels": _LABELS,
    "group_info": [[], None, [{"venue": {"indoor_:room": "1"}}], [{"aim": {"a&b&&c": "2"}}], "x"],
    "keypoints": [[], [0] * 51, [None] * 51, [1.5, 2, 7] * 17, [1e9, 0, 2] * 17],
    "image_id": [0, -1, "1", 1.0, 2**40, None],
    "track_id": [0, -1, "3", 2**31, None],
    "tracking_id": [0, -1, "3", 2**31, None],
    "category_id": [0, -1, "63", 10**6, None],
    "segmentation": [{"size": [480, 3760], "counts": [1, 2]}, {"size": []}, [[1, 2, 3]], None],
    "file_name": ["000003.jpg", "../../x.jpg", "7.jpg", "a/000004.JPG", ""],
    "timestamp": [0, -1, 1e18, "x", None],
    "frame_id": [0, 5, "7", -3, None],
    "name": ["Pedestrian", "t_wall", "m_PERSON", "", "stitched", "x" * 200],
    "K": ["1 2 3", [], None],
}
"""What real files, and other readers' exports, hold under a key now and then."""


def changed(rng, file, raw):
    """Mutate one record's JSON text: bytes, another record, or values as in awkward and hostile files."""
    kind = rng.random()
    if file.layer == "calibration" or kind < 0.45:
        return mutate(rng, raw)[0]
    if kind < 0.55:
        _, other = rng.choice(rng.choice(file.groups).records or [(None, raw)])
        return rng.choice((other, raw + b"," + other, raw + b"," + raw, b""))
    value = json.loads(raw)
    places = list(places_of(value))
    if kind < 0.85:
        named = [(container, key) for container, key in places if key in AWKWARD]
        container, key = rng.choice(named or places)
        container[key] = rng.choice(AWKWARD.get(key, TEXTS))
    else:
        # A part of this record in the place of another, or under a key where it does not belong.
        (container, key), (other, place) = rng.choice(places), rng.choice(places)
        part = json.loads(json.dumps(other[place]))
        container[rng.choice(KEYS) if isinstance(container, dict) and rng.random() < 0.5 else key] = part
    return _raw(value)


# -- unreadable ----------------------------------------------------------------------------------------------------

_NOTHING = [b"5", b'"?"', b"[]", b"{}", b"[[null]]", b"NaN", b"true", b'{"label_id":[[0]]}', b"[1,[2]]"]
_UNREADABLE = [b'[["?"]]', b"NaN", b"-Infinity", b"1e999", b"[null,[]]", b'{"?":[[]],"?":{}}', b"[" * 80 + b"]" * 80]
_NO_LABEL = ["", " ", "\u0000", "\ud800", "x" * 101]
_LABEL_DICTS = re.compile(
    "action_label|social_activity|inter_labels|gender|age|race|venue|aim|inter|BPC|SSC|location_pre"
)
_MARK = "unreadable:"
_MARKED = re.compile(f'"{_MARK}([0-9])"')


def unreadable(rng, file, raw):
    """The record with a part of it, or all, replaced by what nobody can read; it states less, and nothing new."""
    if file.layer == "calibration" or rng.random() < 0.25:
        return rng.choice(_NOTHING)
    value = json.loads(raw)
    for _ in range(rng.choice((1, 1, 2, 5))):
        places = list(places_of(value))
        labels = [(c, k) for c, k in places if isinstance(c[k], dict) and _LABEL_DICTS.fullmatch(str(k)) and c[k]]
        if labels and rng.random() < 0.15:
            container, key = rng.choice(labels)
            inner = container[key]
            inner[rng.choice(_NO_LABEL)] = inner.pop(rng.choice(list(inner)))
            continue
        # Parts near the top are few, those of long lists many.
        near = [(c, k) for c, k in places if c is value] if rng.random() < 0.5 else places
        container, key = rng.choice(near)
        container[key] = _MARK + str(rng.randrange(len(_UNREADABLE)))
    return _marked(value)


def _marked(value):
    """The JSON text of a value in which each mark is replaced by a text that no reader accepts."""
    text = json.dumps(value, separators=(",", ":"))
    return re.sub(_MARKED, lambda found: _UNREADABLE[int(found[1])].decode(), text).encode()


def unreadable_key(rng, file):
    """A member that every record of a file has lost: {place of a record: its text}; of a file without members, none."""
    names = sorted({name for group in file.groups for _, raw in group.records[:1] for name in json.loads(raw)})
    name, mark = rng.choice(names), rng.randrange(len(_UNREADABLE))
    found = {}
    for g, group in enumerate(file.groups):
        for r, (_, raw) in enumerate(group.records):
            value = json.loads(raw)
            if name in value:
                found[g, r] = _marked(value | {name: f"{_MARK}{mark}"})
    return found


def unreadable_group(rng, group):
    """A whole frame that nobody can read."""
    key = group.head[: group.head.index(b":")]
    return rng.choice(
        (key + b":5", key + b":[1,", b'"%d.jpg":[' % rng.randrange(10) + b"]", key + b':{"a":[]}')
    ).replace(b"[1,", b'"?"')
