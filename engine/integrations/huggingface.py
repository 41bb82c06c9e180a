"""Export of a question set as two folders that Hugging Face's `datasets` can load, and of a run's scores for its Hub.

    DIR/public/README.md                      the dataset card, which names the files for `load_dataset`
    DIR/public/croissant.json                 the description of the tables in the format Croissant
    DIR/public/data/questions.parquet, sequences.parquet
    DIR/private/README.md
    DIR/private/opaque.key                    the key of the opaque names and ids
    DIR/private/data/answers.parquet, evidence.parquet, names.parquet

The answers need a private folder, because every file of a published folder can be downloaded. In the public folder,
sequences have opaque names. The private table `names` gives the real name for each opaque name. In both folders,
questions have opaque ids. Neither folder has pictures.
"""

from __future__ import annotations

import datetime
import re
import shutil
from collections import Counter
from collections.abc import Collection, Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import yaml

from jrdb_avr import __version__
from jrdb_avr.engine.generate.blind import question_texts
from jrdb_avr.engine.generate.guessers import COUNTING
from jrdb_avr.engine.integrations.croissant import Release, croissant, sentence
from jrdb_avr.engine.report.run_scores import read_submission, score_run
from jrdb_avr.engine.report.scored_runs import read_index
from jrdb_avr.engine.report.scoring import DEFAULT_IOU
from jrdb_avr.engine.report.tables import INTERVALS, score_columns
from jrdb_avr.engine.report.truth import is_imported, read_truth
from jrdb_avr.engine.run.public import rename
from jrdb_avr.engine.validate.scene_guessers import check_store
from jrdb_avr.queries.files import new_folder, write_bytes
from jrdb_avr.queries.opaque import key_path, opaque_ids, opaque_names
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema import card
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ABOUT, CANARY, GENERATION_KEY, QUESTIONS, column

_PRIVATE: Final = ("answers", "evidence")
_NAMES: Final = pa.schema([pa.field("sequence", pa.string(), False), pa.field("name", pa.string(), False)])
_ABOUT_NAMES: Final = (
    "The recording behind each sequence of the public folder.",
    [("sequence", "Its opaque name."), ("name", "Its name in JRDB.")],
)

_IMPORTED: Final = (
    "Questions about people in 360-degree video that a mobile robot recorded. Another program wrote them; jrdb-avr "
    "checked their form and their boxes, and proved no answer. The publisher keeps answers and boxes for scoring."
)
_RESULTS: Final = """\
# A file .eval_results/NAME.yaml for the repository of a model. Values are percentages of all questions of the run.
# The form has no fields for the method, the interval, the selection of questions and the marks of a run: see the notes.
"""
_DATASET: Final = re.compile(r"https://huggingface\.co/datasets/([\w.-]+/[\w.-]+)/?")
_SIZES: Final = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))


def export_folders(
    store: Store | str | Path,
    folder: str | Path,
    creator: str = card.CREATOR,
    url: str = card.HOME,
    published: datetime.date | None = None,
) -> tuple[Path, Path]:
    """Write the questions of a store as a public folder, and the answers as a private folder.

    Args:
        store: The store, or its folder.
        folder: The parent folder of the public and the private folder. It must be missing or empty.
        creator: Name of the publisher of the questions.
        url: Address of the publication.
        published: Day of the publication. None means today (UTC).

    Returns:
        The paths of the public folder and of the private folder.

    Raises:
        StoreError: If the store has no questions, or if it has a training set.
        InputError: If the folder is not empty.
    """
    store, folder = Store.of(store), Path(folder)
    store.refuse_training()
    with new_folder(folder) as made:
        _write(store, made / "public", made / "private", creator, url, published)
    return folder / "public", folder / "private"


def _write(store: Store, public: Path, private: Path, creator: str, url: str, published: datetime.date | None) -> None:
    questions, sequences, answers, _ = store.question_tables("questions", "sequences", *_PRIVATE)
    names = opaque_names(store, sequences["sequence"].to_pylist())
    ids = opaque_ids(store, questions["question_id"].to_pylist())
    sources = _sources(store, names)
    evidence = {names[name]: kind for name, kind in store.visibility().items() if name in names}
    generation = (questions.schema.metadata or {}).get(GENERATION_KEY.encode(), b"").decode()
    metadata = {"canary": CANARY, GENERATION_KEY: generation}
    day = published or datetime.datetime.now(datetime.UTC).date()
    summary, rai = (_IMPORTED, {}) if is_imported(store) else (card.SUMMARY, card.RAI)
    release = Release(f"{__version__}+{generation[:12]}", day, creator, url, summary, rai)

    private.mkdir(0o700)
    (private / "data").mkdir()
    shutil.copyfile(store.question_path("evidence"), private / _path("evidence"))
    shutil.copyfile(key_path(store), private / key_path(store).name)
    judged = rename(answers, "question_id", ids).sort_by("question_id")
    kept = {key.decode(): text.decode() for key, text in (answers.schema.metadata or {}).items()}
    write_table(private / _path("answers"), judged, answers.schema.remove_metadata(), kept)
    mapping = pa.table({"sequence": list(names.values()), "name": list(names)}, _NAMES)
    write_table(private / _path("names"), mapping.sort_by("sequence"), _NAMES, metadata)
    shared = {"title": card.TITLE, "release": release, "canary": CANARY, "n": len(questions)}
    about = _columns(_PRIVATE) | {"names": _ABOUT_NAMES}
    write_bytes(private / "README.md", _render("private_card.md", head=_yaml(_configs(about)), tables=about, **shared))

    # Rows are sorted by ids and opaque names, because an order by real names would help to guess the real names.
    tables = {
        "questions": rename(rename(questions, "sequence", names), "question_id", ids).sort_by("question_id"),
        "sequences": rename(sequences, "sequence", names).sort_by("sequence"),
    }
    for name, table in tables.items():
        write_table(public / _path(name), table, QUESTIONS[name], metadata)
    described = croissant(public, {name: _path(name) for name in tables}, sources, release)
    write_bytes(public / "croissant.json", msgspec.json.format(msgspec.json.encode(described), indent=2) + b"\n")
    text = _render(
        "card.md",
        head=_yaml(_head(len(questions), sources) | _configs(tables)),
        synthetic=card.SYNTHETIC if card.SAMPLE in sources else "",
        sequences=len(sequences),
        counts={title: _counts(questions[name]) for name, title in (("family", "family"), ("answer_mode", "answer"))},
        tables=_columns(tables),
        evidence=dict(sorted(evidence.items())),
        blind=[] if is_imported(store) else check_store(store, question_texts(questions, answers)),
        counting=COUNTING,
        sources=sources,
        home=card.HOME,
        cite=card.CITE,
        **shared,
    )
    write_bytes(public / "README.md", text)


def _path(table: str) -> str:
    """Return the path of a table's file, relative to the public or private folder."""
    return f"data/{table}.parquet"


def sources_of(layers: Collection[str]) -> list[card.Source]:
    """Return the published data sets that provide at least one of the given layers."""
    return [source for source in card.SOURCES if set(source.layers) & set(layers)]


def licence_of(sources: Collection[card.Source]) -> str:
    """Return the licence identifier that all given sources share, or "other" if their licences differ."""
    licences = {source.licence for source in sources}
    return licences.pop() if len(licences) == 1 else "other"


def _sources(store: Store, sequences: Iterable[str]) -> list[card.Source]:
    """Return the data sets that the layers of the sequences come from. The sample world counts as a data set."""
    entries = store.manifest().sequences
    real = [name for name in sequences if not card.is_of_sample(name)]
    layers = {layer for name in real for layer in entries[name].layers}
    return sources_of(layers) + ([card.SAMPLE] if any(map(card.is_of_sample, sequences)) else [])


def model_results(store: Store, run_id: str, url: str) -> str:
    """Return the scores of a run as the results file of a model on Hugging Face.

    Args:
        store: The store of the run, with answers.
        run_id: The id of the run.
        url: Address of the published questions on Hugging Face.

    Returns:
        YAML with one entry per score. The notes of an entry state what the form has no fields for.

    Raises:
        StoreError: If the run or the answers are missing, or if the store has a training set.
        InputError: If `url` is not the address of a data set on Hugging Face.
    """
    if (dataset := _DATASET.fullmatch(url)) is None:
        raise InputError(
            f"{url!r} is no data set of Hugging Face: give https://huggingface.co/datasets/...", field="url"
        )
    store.refuse_training()
    run = score_run(read_truth(store), read_submission(store, run_id), DEFAULT_IOU)
    row, manifest = score_columns(read_index(store), run), run.manifest
    asked = f"{row['n']} questions of {row['sequences']} sequences, hash {manifest.questions_sha256[:16]}"
    about = [f"method {manifest.method}", *filter(None, [run.label]), asked, f"minimum IoU {DEFAULT_IOU:g}"]
    entries = []
    for name in ("combined", "answer", "evidence"):
        bounds = f": {row[f'{name}_low']} to {row[f'{name}_high']}" if row["interval"] == INTERVALS else ""
        notes = "; ".join([*about, row["interval"] + bounds])
        task = {"id": dataset[1], "task_id": name}
        entries.append({"dataset": task, "value": row[name], "date": manifest.created, "notes": notes})
    return _RESULTS + _yaml(entries)


# -- the cards --------------------------------------------------------------------------------------------------------


def _head(n: int, sources: list[card.Source]) -> dict[str, Any]:
    """Return the front matter of the public card, without the part that `_configs` returns."""
    return {
        "pretty_name": card.TITLE,
        "license": licence_of(sources),
        "language": ["en"],
        "task_categories": ["visual-question-answering"],
        "tags": ["croissant", "active-vision", "robotics", *(["synthetic"] if card.SAMPLE in sources else [])],
        "size_categories": [next((name for most, name in _SIZES if n < most), "n>1M")],
    }


def _configs(tables: Iterable[str]) -> dict[str, Any]:
    """Return the part of the front matter that names the files for `load_dataset`. The first table is the default."""
    configs: list[dict[str, Any]] = [
        {"config_name": name, "data_files": [{"split": "test", "path": _path(name)}]} for name in tables
    ]
    configs[0]["default"] = True
    return {"configs": configs}


def _yaml(head: Any) -> str:
    """Return a value as YAML."""
    text: str = yaml.safe_dump(head, sort_keys=False, allow_unicode=True)
    return text


def _counts(column: pa.ChunkedArray) -> list[tuple[str, int]]:
    return sorted(Counter(column.to_pylist()).items())


def _columns(tables: Iterable[str]) -> dict[str, tuple[str, list[tuple[str, str]]]]:
    """Return the description of each table, and the name and the meaning of each column."""
    return {
        table: (ABOUT[table], [(name, sentence(column(table, name)[1])) for name in QUESTIONS[table].names])
        for table in tables
    }


def _render(name: str, **values: Any) -> bytes:
    import jinja2

    text = files(__package__).joinpath(name).read_text("utf-8")
    # Values are not escaped for HTML, because that would spoil Markdown.
    template = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True, keep_trailing_newline=True)  # noqa: S701
    return template.from_string(text).render(values).encode()
