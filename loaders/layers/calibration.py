"""Loader of the camera calibration, which makes the table `calibration` from `calibration/cameras.yaml`.

Under `cameras`, each `sensor_N` has a `width`, a `height` and a 3x3 matrix `K`. The matrix is one string of nine
numbers in pixels: fx 0 cx, 0 fy cy, 0 0 1. JRDB publishes the file in this layout, and so does the
repository StanfordVL/JRMOT_ROS. `schema.panorama` computes rows of the panorama with two constants. One constant should
equal the median of fy over the cameras, and the other the median of cy. `cameras_check` compares constants and medians.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import yaml

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import LayerTables
from jrdb_avr.loaders.labelfiles.frames import read_file
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.loaders.report import Cameras
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.panorama import FOCAL_ROWS, HORIZON_ROW
from jrdb_avr.schema.tables import ANNOTATIONS

_MAX_BYTES: Final = 64 << 10
"""Maximum bytes of the file. JRDB's file is twenty times smaller. The parser takes a second for a file of this size."""
MAX_PIXELS: Final = 100_000
"""Maximum width, height, focal length and centre of a camera in pixels."""
TOLERANCE: Final = 0.05
"""Maximum relative difference between a median over the cameras and the constant of the panorama."""

_NUMBER: Final = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")

# All sequences of a root share the file, and the YAML parser is slow. Therefore the tree of the last file is kept.
_tree: Final = functools.lru_cache(maxsize=1)(lambda text: yaml.compose(text, yaml.SafeLoader))

_Row = tuple[str, int | None, int | None, float, float, float, float]


def load_calibration(path: Path, problems: Problems) -> LayerTables:
    """Read the cameras of a root.

    Args:
        path: `cameras.yaml`.
        problems: counter of refused parts.

    Returns:
        The table `calibration`, sorted by camera. The dictionary of frames is empty.

    Raises:
        InputError: If the file as a whole cannot be used.
    """
    rows: list[_Row] = []
    for name, node in _cameras(path, problems).items():
        try:
            rows.append(_camera(name, node, problems))
        except ValueError as error:
            problems.add("record", str(error), frame=name, field="K")
    schema = ANNOTATIONS["calibration"].remove(0)
    table = pa.Table.from_pylist([dict(zip(schema.names, row, strict=True)) for row in sorted(rows)], schema)
    return LayerTables({"calibration": table}, {})


def cameras_check(table: pa.Table) -> Cameras | None:
    """Compare the medians of fy and cy with the constants of the panorama.

    Return the comparison, or None if the table `calibration` is empty.
    """
    if not table.num_rows:
        return None
    fy, cy = float(np.median(table["fy"].to_numpy())), float(np.median(table["cy"].to_numpy()))
    agrees = abs(fy / FOCAL_ROWS - 1) <= TOLERANCE and abs(cy / HORIZON_ROW - 1) <= TOLERANCE
    return Cameras(table.num_rows, fy, FOCAL_ROWS, cy, HORIZON_ROW, agrees)


def _cameras(path: Path, problems: Problems) -> dict[str, yaml.Node]:
    """Return the YAML node of each camera in the file, by the camera's name.

    The text is only parsed into nodes. No objects are made from the nodes, so YAML tags in the file have no effect.
    """
    text = read_file(path)
    if len(text) > _MAX_BYTES:
        raise InputError(f"{path.name}: larger than the limit of {_MAX_BYTES >> 10} kB", file=path.name)
    try:
        top = _tree(text.decode())
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        raise InputError(f"{path.name}: not YAML{line}", file=path.name) from None
    except (RecursionError, UnicodeError, ValueError):
        raise InputError(f"{path.name}: cannot be read as YAML", file=path.name) from None
    cameras = _members(top, "", problems).get("cameras")
    if not isinstance(cameras, yaml.MappingNode):
        raise InputError(f'{path.name}: there is no mapping "cameras"', file=path.name)
    return _members(cameras, "cameras", problems)


def _members(node: yaml.Node | None, name: str, problems: Problems) -> dict[str, yaml.Node]:
    """Return the members of a YAML mapping by key, or {} for any other node. A repeated key keeps its first value."""
    members: dict[str, yaml.Node] = {}
    for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
        if not isinstance(key, yaml.ScalarNode):
            problems.add("field", "key is not a string", frame=name)
        elif key.value in members:
            problems.add("field", "key is repeated, the first is kept", frame=name, field=shorten(key.value))
        else:
            members[key.value] = value
    return members


def _camera(name: str, node: yaml.Node, problems: Problems) -> _Row:
    """Return the row of a camera in the table `calibration`. Raise ValueError if the matrix `K` is unusable."""
    sensor = records.read_text(name)
    values = _members(node, sensor, problems)
    sizes: list[int | None] = []
    for field in ("width", "height"):
        size = values.get(field)
        try:
            sizes.append(None if size is None else records.read_whole(_scalar(size), 1, MAX_PIXELS))
        except ValueError as error:
            sizes.append(None)
            problems.add("field", str(error), frame=sensor, field=field)
    if "K" not in values:
        raise ValueError("K is missing")
    matrix = [_number(text) for text in _texts(values["K"])]
    if len(matrix) != 9:
        raise ValueError("K: not nine numbers")
    fx, _, cx, zero, fy, cy = matrix[:6]
    if not (fx > 0 and fy > 0 and zero == 0 and matrix[6:] == [0, 0, 1]):
        raise ValueError("K: not the matrix of a camera")
    if max(fx, fy, abs(cx), abs(cy)) > MAX_PIXELS:
        raise ValueError("K: number out of range")
    return sensor, sizes[0], sizes[1], fx, fy, cx, cy


def _texts(node: yaml.Node) -> list[str]:
    """Return the elements of a matrix as strings.

    The node of the matrix is a string, a list of nine numbers, or a list of three rows with three numbers each.
    """
    if isinstance(node, yaml.ScalarNode):
        return str(node.value).split()
    if not isinstance(node, yaml.SequenceNode):
        raise ValueError("K: not nine numbers")
    parts = [part.value if isinstance(part, yaml.SequenceNode) else [part] for part in node.value[:10]]
    return [_scalar(inner) for part in parts for inner in part[:10]]


def _scalar(node: yaml.Node) -> str:
    if not isinstance(node, yaml.ScalarNode):
        raise ValueError("not a number")
    return str(node.value)


def _number(text: str) -> float:
    if not _NUMBER.fullmatch(text):
        raise ValueError("K: not nine numbers")
    return records.read_number(float(text))
