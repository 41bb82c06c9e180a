"""Import of questions that another program wrote: as JSON lines, as Parquet, or as the folders of `export --hf`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.publish import publish
from jrdb_avr.engine.report.prediction_lines import LARGEST_FILE, make_whole
from jrdb_avr.engine.report.tables import TABLES
from jrdb_avr.engine.report.truth import is_imported, is_inside
from jrdb_avr.engine.run.public import rename
from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.loaders.layers.boxes_2d import box_warnings
from jrdb_avr.queries.files import write_once
from jrdb_avr.queries.opaque import key_path
from jrdb_avr.queries.store import Store, is_plain_name, read_table
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.answers import AnswerMode, Evidence
from jrdb_avr.schema.errors import DecodeError, InputError, StoreError, did_you_mean, warn
from jrdb_avr.schema.panorama import HEIGHT, WIDTH
from jrdb_avr.schema.questions import IMPORTED_KEY
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS
from jrdb_avr.schema.wording.text import question_id

_Row = dict[str, Any]
_Text = Annotated[str, msgspec.Meta(min_length=1, max_length=10_000)]
_Name = Annotated[str, msgspec.Meta(pattern=r"^[\w .:/-]{1,64}$")]
_COLUMN: Final = re.compile(r"[A-Za-z]\w{0,40}", re.ASCII)
_RESERVED_ID: Final = re.compile(r"[0-9a-f]{16}|.{65,}")
_MARK: Final = GENERATION_KEY.encode()
_COLUMNS: Final = pa.schema(dict.fromkeys((*QUESTIONS["questions"], *QUESTIONS["answers"])))
_TAKEN: Final = {
    *_COLUMNS.names,
    *(*TABLES, "run", "method", "model", "label", "n", "evidence", "combined", "hallucination", "invalid"),
}
"""Names of columns of stores and reports, which no other key of a line may have."""


class QuestionLine(msgspec.Struct, frozen=True):
    """A question of another program. Other keys of the line become columns of `answers`.

    `evidence` has boxes around the person that the answer is about. A predicted box at any of these frames counts.
    """

    question_id: str
    sequence: str
    question: _Text
    answer_mode: AnswerMode
    answer: dict[str, int | float | None]
    evidence: Annotated[tuple[Evidence, ...], msgspec.Meta(min_length=1)]
    choices: tuple[_Text, ...] = ()
    family: _Name = "imported"
    template: _Name = "imported"

    @property
    def answer_json(self) -> str:
        """The answer as the store keeps it. A Parquet column has the keys of all modes, so that some are null."""
        return _encode({key: value for key, value in self.answer.items() if value is not None})


def _encode(value: Any) -> str:
    return msgspec.json.encode(value).decode()


def import_questions(store: Store | str | Path, paths: Sequence[str | Path]) -> int:
    """Import questions of another program into a store without generated questions.

    Earlier imported questions are replaced.

    Args:
        store: The store, or its folder. The sequences of the questions must be loaded.
        paths: Files of JSON lines or Parquet, which become one set of questions, or the folders of `export --hf`.

    Returns:
        The number of imported questions.

    Raises:
        InputError: If a file cannot be read, or a line is wrong. The message names the file and the line.
        StoreError: If nothing is loaded, or the store has generated questions.
    """
    store, files = Store.of(store), [Path(path) for path in paths]
    store.manifest()
    with store.writing("import-questions"):
        if store.question_path("questions").exists() and not is_imported(store):
            raise StoreError(f"{store.path} has generated questions: load the annotations into another store")
        if any(path.is_dir() for path in files):
            return _import_folders(store, files)
        infos = {name: _info(store, name) for name in sorted(store.manifest().sequences)}
        read: dict[str, tuple[QuestionLine, _Row]] = {}
        where = ""
        try:
            for path in files:
                where = str(path)
                for at, content in _contents(path):
                    where = f"{path}, {at}"
                    line, columns = _check(content, infos)
                    if line.question_id in read:
                        raise ValueError(f"question {line.question_id!r} comes twice: give each question its own id")
                    read[line.question_id] = line, columns
        except (ValueError, DecodeError, RecursionError, pa.ArrowException) as error:
            raise InputError(f"{where}: {' '.join(str(error).split())}", field=where) from None
        if not read:
            raise InputError(f"{where}: there is no question: write one JSON object per line")
        _publish(store, [read[name] for name in sorted(read)], infos, ", ".join(path.name for path in files))
    return len(read)


def _info(store: Store, name: str) -> _Row:
    """Return the row of a sequence in the table `sequences`."""
    (head,), frames = (store.interval(kind, name).to_pylist() for kind in ("sequence", "frames"))
    shown = "image" if "images" in head["layers"] else "annotated"
    return {**head, "frames": sorted(row["frame"] for row in frames if row[shown])}


def _contents(path: Path) -> Iterator[tuple[str, bytes | _Row]]:
    """Yield the position and the content of each question of a file."""
    data = read_input(path, LARGEST_FILE)
    if data.startswith(b"PAR1"):
        for index, row in enumerate(pq.ParquetFile(pa.BufferReader(data)).read().to_pylist(), 1):
            yield f"row {index}", {name: value for name, value in row.items() if value is not None}
        return
    for index, line in enumerate(to_utf8(data, path).split(b"\n"), 1):
        if line.strip():
            yield f"line {index}", line


def _check(content: bytes | _Row, infos: Mapping[str, _Row]) -> tuple[QuestionLine, _Row]:
    """Return a checked question, and its other keys. Raise an error that says what to change."""
    fields = msgspec.json.decode(content, type=_Row) if isinstance(content, bytes) else content
    for key in {"answer", "evidence", "choices"} & fields.keys():
        if isinstance(fields[key], str):  # A column of a Parquet file may have JSON texts.
            fields[key] = msgspec.json.decode(fields[key])
    line = msgspec.convert(make_whole(fields), QuestionLine)
    name, mode, choices, answer = line.question_id, MODES[line.answer_mode], line.choices, line.answer_json
    if not is_plain_name(name) or _RESERVED_ID.fullmatch(name):
        letters = "use at most 64 letters, digits, '.', '_' and '-', but not 16 hexadecimal digits as 'generate' does"
        raise ValueError(f"question_id {name[:70]!r}: {letters}")
    if line.sequence not in infos:
        raise ValueError(f"sequence {line.sequence[:60]!r} is not loaded{did_you_mean(line.sequence, infos)}")
    if len(set(choices)) < len(choices) or not 2 * mode.is_choice <= len(choices) <= 26 * mode.is_choice:
        raise ValueError("choices: give 2 to 26 different texts for multiple_choice, and none for another mode")
    frame_count, frames = infos[line.sequence]["frame_count"], [seen.frame for seen in line.evidence]
    if not is_inside(mode.decode(answer), len(choices), frame_count):
        allowed = f"a choice from 1 to {len(choices)}" if choices else f"frames below {frame_count}, or more than 0"
        raise ValueError(f"answer {answer}: give {allowed}")
    if len(set(frames)) < len(frames) or max(frames) >= frame_count:
        raise ValueError(f"evidence: give one box per frame, at frames below {frame_count}")
    for x, y, w, h in (seen.box for seen in line.evidence):
        if not (w > 0 and h > 0 and abs(x) + w <= 2 * WIDTH and abs(y) + h <= 2 * HEIGHT):
            raise ValueError("evidence: a box is x, y, width and height in stitched pixels")
    others = {key: value for key, value in fields.items() if key not in QuestionLine.__struct_fields__}
    if wrong := [key for key in others if not _COLUMN.fullmatch(key) or key.lower() in _TAKEN]:
        raise ValueError(f"key {wrong[0][:60]!r} cannot be a column: rename it, with a new name of letters and digits")
    return line, {key: value if isinstance(value, str) else _encode(value) for key, value in others.items()}


def _publish(store: Store, read: Sequence[tuple[QuestionLine, _Row]], infos: Mapping[str, _Row], source: str) -> None:
    """Write the tables of checked questions. The target of question n, from 1, is the track -n, which no person has."""
    blank = {field.name: "" if field.type == pa.string() else 0 for field in _COLUMNS if not field.nullable}
    names = sorted({name for _, others in read for name in others})
    blank |= {"proofs": "[]", "bindings": "{}", "needed": "[]", **dict.fromkeys(names, "")}
    rows, boxes = [], []
    for track, (line, others) in enumerate(read, 1):
        given = msgspec.structs.asdict(line) | {"answer": line.answer_json, "target_track": -track} | others
        rows.append(blank | given)
        for seen in line.evidence:
            sides = dict(zip("xywh", seen.box, strict=True))
            boxes.append({"sequence": line.sequence, "track": -track, "frame": seen.frame, **sides})
    added = [pa.field(name, pa.string(), nullable=False) for name in names]
    asked = [infos[name] for name in sorted({line.sequence for line, _ in read})]
    tables = {"rejected": [], "sequences": asked, "evidence": boxes}
    for warning in box_warnings(pa.Table.from_pylist(boxes)):
        warn(f"evidence: {warning}")
    publish(
        store,
        pa.Table.from_pylist(rows, pa.schema([*_COLUMNS, *added])),
        {name: pa.Table.from_pylist(some, QUESTIONS[name]) for name, some in tables.items()},
        {"canary": CANARY, IMPORTED_KEY: source},
    )


def _import_folders(store: Store, paths: Sequence[Path]) -> int:
    """Import the public and the private folder that `export --hf` wrote. They keep their plans, if they have any."""
    folders = [folder / "data" for path in paths for folder in (path, path / "public", path / "private")]
    files = {file.stem: file for folder in folders for file in folder.glob("*.parquet")}
    if lacking := {"questions", "sequences", "answers", "evidence", "names"} - files.keys():
        raise InputError(f"{min(lacking)}.parquet is missing: give the public and the private folder of 'export --hf'")
    tables = {name: read_table(file) for name, file in files.items()}
    names = {row["sequence"]: row["name"] for row in tables["names"].to_pylist()}
    if missing := names.values() - store.manifest().sequences.keys():
        raise InputError(f"sequence {min(missing)!r} of the folders is not loaded: load it first")
    for name in ("questions", "sequences"):
        tables[name] = rename(tables[name], "sequence", names).sort_by(QUESTIONS[name].names[0])
    questions, answers = tables["questions"], tables["answers"].sort_by("question_id")
    metadata = tables["answers"].schema.metadata or {}
    marks = [(table.schema.metadata or {}).get(_MARK) for table in tables.values()]
    if set(marks) != {metadata.get(_MARK)} or not questions["question_id"].equals(answers["question_id"]):
        raise InputError("the folders are of different exports: give the two folders of one 'export --hf'")
    for field in answers.schema.remove(answers.schema.get_field_index("question_id")):
        questions = questions.append_column(field, answers[field.name])
    if IMPORTED_KEY.encode() not in metadata:  # The ids of the store are hashes of the public columns.
        rows = tables["questions"].drop_columns("question_id").to_pylist()
        questions = questions.set_column(0, "question_id", pa.array([question_id(**row) for row in rows]))
    for key in (path / part / key_path(store).name for path in paths for part in (".", "private")):
        if key.is_file() and not key_path(store).exists():
            write_once(key_path(store), read_input(key, 1 << 10))
    tables["rejected"] = QUESTIONS["rejected"].empty_table()
    kept = {key.decode(): text.decode() for key, text in metadata.items()}
    publish(
        store,
        questions.sort_by("question_id"),
        {name: tables[name] for name in ("rejected", "sequences", "evidence")},
        kept,
    )
    return len(questions)
