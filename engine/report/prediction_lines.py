"""Predictions as lines of JSON. Predictions are exported from a store and imported into a store in this format.

Each line is one JSON object. Only the key `question_id` is required. A line without `answer` and `evidence` means that
the question was asked and not answered.

    {"question_id": "0098303b6414dec4", "answer": {"choice": 2}, "evidence": {"frame": 150, "box": [10, 20, 60, 180]}}

`answer` is an answer as in `schema/answers.py`. `box` is x, y, w, h in stitched pixels. The other keys are columns of
the table `predictions`. A whole number may be written as a float, such as 2.0. Lines are untrusted, so the file size,
the length of a line and each value have limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.answers import Evidence
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.method import Status, Verdict
from jrdb_avr.schema.tables import RUNS

LARGEST_FILE: Final = 1 << 28
"""Maximum size in bytes of a file of predictions. A file with 2,098 short replies has a thousandth of this size."""

LARGEST_LINE: Final = 1 << 20
"""Maximum length of a line in bytes."""

_Count = Annotated[int, msgspec.Meta(ge=0, le=2**31 - 1)]
_Tokens = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
_Seconds = Annotated[float, msgspec.Meta(ge=0, le=2.0**53)]
_Id = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]


class PredictionLine(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The prediction for one question. The keys after `evidence` say how the prediction was made, and at what cost."""

    question_id: _Id
    status: Status = "answered"
    answer: dict[str, int | float] | None = None
    evidence: Evidence | None = None
    raw: str = ""
    reason: str = ""
    verdict: Verdict | None = None
    proposed: str | None = None
    n_observations: _Count = 0
    n_model_calls: _Count = 0
    prompt_tokens: _Tokens = 0
    completion_tokens: _Tokens = 0
    seconds: _Seconds = 0.0


_JSON: Final = msgspec.json.Decoder()
_WHOLE: Final = frozenset(("n_observations", "n_model_calls", "prompt_tokens", "completion_tokens")).union(
    name for mode in MODES.values() for name, kind in mode.fields if kind in ("choice", "frame")
)
"""Keys of whole numbers."""
_BOX: Final = ("x", "y", "w", "h")
_SAME: Final = tuple(name for name in PredictionLine.__struct_fields__ if name not in ("answer", "evidence"))


def write_lines(predictions: pa.Table) -> Iterator[bytes]:
    """Write predictions as lines. The lines have no run id, because a new run id is chosen when lines are imported.

    Args:
        predictions: Rows of the table `predictions`.

    Yields:
        One line per row, with a line break.

    Raises:
        StoreError: If a row has a value that a line cannot hold.
    """
    for row in predictions.to_pylist():
        frame, box = row["evidence_frame"], [row[f"evidence_{side}"] for side in _BOX]
        evidence = None if frame is None else {"frame": frame, "box": box}
        try:
            answer = None if row["answer"] is None else msgspec.json.decode(row["answer"])
            fields = {name: row[name] for name in _SAME} | {"answer": answer, "evidence": evidence}
            yield msgspec.json.encode(msgspec.convert(fields, PredictionLine)) + b"\n"
        except msgspec.MsgspecError as error:
            question = row["question_id"]
            raise StoreError(f"the prediction of question {question} cannot be written as JSON: {error}") from None


def parse_lines(data: bytes, run_id: str, file: Path, stored: Mapping[str, str] = MappingProxyType({})) -> pa.Table:
    """Make the table `predictions` of a run from lines.

    Args:
        data: The bytes of all lines.
        run_id: The id of the run.
        file: The path of the file, for messages.
        stored: The id in the store of each question, by opaque id. All other ids stay.

    Returns:
        The table, in the order of the lines.

    Raises:
        InputError: If a line cannot be read or repeats a question. The message names the file and the line.
    """
    rows = []
    ids: set[str] = set()
    for line_number, line in enumerate(data.split(b"\n"), 1):
        if not line.strip():
            continue
        try:
            if len(line) > LARGEST_LINE:
                raise ValueError(f"it is longer than {LARGEST_LINE} bytes")
            record = msgspec.convert(make_whole(_JSON.decode(line)), PredictionLine)
            # An invalid prediction keeps its answer if only its box could not be read, for a reason.
            partial = record.status == "invalid" and record.reason and not record.evidence
            if record.answer and record.status != "answered" and not partial:
                raise ValueError(
                    f"its status is {record.status}, but it has an answer: remove the status or the answer"
                )
            record = msgspec.structs.replace(record, question_id=stored.get(record.question_id, record.question_id))
            if record.question_id in ids:
                raise ValueError(f"question {record.question_id!a} comes twice")
            ids.add(record.question_id)
            rows.append(_row(record, run_id))
        except (ValueError, RecursionError) as error:
            # Line breaks are removed, because the message may quote an unknown key that contains line breaks.
            message = " ".join(str(error).split())
            raise InputError(
                f"{file}, line {line_number}: {message}", file=str(file), field=f"line {line_number}"
            ) from None
    return pa.Table.from_pylist(rows, RUNS["predictions"])


def make_whole(value: Any) -> Any:
    """Turn whole numbers into integers, because pandas writes a column that has a gap as floats.

    Args:
        value: JSON of untrusted lines.

    Returns:
        The JSON with integers in all fields of whole numbers.

    Raises:
        ValueError: If such a field has another float.
    """
    if isinstance(value, list):
        return [make_whole(item) for item in value]
    if not isinstance(value, dict):
        return value
    fields = {key: make_whole(field) for key, field in value.items()}
    for key in (key for key in _WHOLE & fields.keys() if isinstance(fields[key], float)):
        if not fields[key].is_integer():
            raise ValueError(f"{key} must be a whole number, not {fields[key]}")
        fields[key] = int(fields[key])
    return fields


def _row(line: PredictionLine, run_id: str) -> dict[str, Any]:
    answer = None if line.answer is None else msgspec.json.encode(line.answer).decode()
    row: dict[str, Any] = {"run_id": run_id, "answer": answer} | {name: getattr(line, name) for name in _SAME}
    if line.evidence is not None:
        row["evidence_frame"] = line.evidence.frame
        row |= {f"evidence_{side}": value for side, value in zip(_BOX, line.evidence.box, strict=True)}
    return row
