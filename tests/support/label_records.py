"""Social label files with one record, and people at stated places."""

from __future__ import annotations

import json

from jrdb_avr.loaders.layers.social import load_social
from jrdb_avr.loaders.problems import Problems

NAME = "yard-2020-01-01_0"


BOX = (100, 60, 50, 200)


def read(tmp_path, content, loader=load_social):
    """The reading of one file and its problems. `content`: records of frame 0, {frame: records}, or text."""
    path = tmp_path / f"{NAME}.json"
    if isinstance(content, list):
        content = {0: content}
    if isinstance(content, dict):
        content = json.dumps({"labels": {f"{frame:06d}.jpg": records for frame, records in content.items()}})
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    problems = Problems(path.name)
    return loader(path, problems).of(NAME), problems.listed()


def rows(reading, layer):
    """Rows of an annotation table as tuples, without sequence, and without the frame where all are of frame 0."""
    table = reading.tables[layer]
    names = [name for name in table.column_names if name not in ("sequence", "raw")]
    return [tuple(row[name] for name in names) for row in table.to_pylist()]


def reasons(problems):
    return [(p.reason, p.field, p.frame, p.count) for p in problems]


def record(**fields):
    return {"label_id": "pedestrian:1", "box": list(BOX)} | fields


def placed(track):
    return (100 * track + 10, 60, 50, 200)
