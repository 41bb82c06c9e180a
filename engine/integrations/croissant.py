"""Metadata of a published folder in the format Croissant 1.1, with the responsible-AI extension."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import pyarrow as pa

from jrdb_avr.queries.files import file_hash
from jrdb_avr.schema.card import CITE, HOME, SAMPLE, SYNTHETIC, TITLE, Source
from jrdb_avr.schema.tables import ABOUT, CANARY, QUESTIONS, column

KEYS: Final = {"questions": "question_id", "sequences": "sequence"}
"""Name of the key column of each published table."""

_CONTEXT: Final = msgspec.json.decode(files(__package__).joinpath("croissant_context.json").read_bytes())
"""The JSON-LD context that Croissant 1.1 prescribes."""

_TYPES: Final = {pa.string(): "sc:Text", pa.int32(): "sc:Integer", pa.float64(): "sc:Float"}


class Release(NamedTuple):
    """Facts about a published question set.

    Attributes:
        version: Version of the program with a hash of the questions.
        published: Day of publication.
        creator: Publisher.
        url: Address of the publication.
        summary: Description in two or three sentences.
        rai: Texts about responsible use, by their property in Croissant.
    """

    version: str
    published: datetime.date
    creator: str
    url: str
    summary: str
    rai: Mapping[str, str]


def croissant(folder: Path, paths: Mapping[str, str], sources: Sequence[Source], release: Release) -> dict[str, Any]:
    """Describe the tables of a published folder.

    Args:
        folder: The folder.
        paths: Path of each table's file, relative to the folder, by the name of the table.
        sources: The data sets that the questions come from.
        release: Version, day, publisher and address.

    Returns:
        The metadata as a JSON-LD object.
    """
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"],
        "name": TITLE,
        "description": " ".join([release.summary, *([SYNTHETIC] if SAMPLE in sources else []), CANARY]),
        "version": release.version,
        "datePublished": release.published.isoformat(),
        "creator": {"@type": "sc:Organization", "name": release.creator},
        "url": release.url,
        "citeAs": CITE,
        "inLanguage": "en",
        "keywords": ["active vision", "visual question answering", "360-degree video", "people", "robot"],
        "license": sorted({source.licence_url for source in sources}),
        "isBasedOn": [
            {"@type": "sc:CreativeWork", "name": source.name, "url": HOME, "license": source.licence_url}
            for source in sources
        ],
        **{f"rai:{name}": text for name, text in release.rai.items()},
        "distribution": [_file(folder, table, path) for table, path in paths.items()],
        "recordSet": [_records(table) for table in paths],
    }


def _file(folder: Path, table: str, path: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": f"{table}-file",
        "name": path,
        "description": ABOUT[table],
        "contentUrl": path,
        "contentSize": f"{(folder / path).stat().st_size} B",
        # Not Parquet's registered type, because mlcroissant accepts that type but then fails to load the file.
        "encodingFormat": "application/x-parquet",
        "sha256": file_hash(folder / path),
    }


def _records(table: str) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": table,
        "name": table,
        "description": ABOUT[table],
        "key": {"@id": f"{table}/{KEYS[table]}"},
        "field": [_field(table, field) for field in QUESTIONS[table]],
    }


def _field(table: str, field: pa.Field) -> dict[str, Any]:
    is_list = pa.types.is_list(field.type)
    described = {
        "@type": "cr:Field",
        "@id": f"{table}/{field.name}",
        "name": field.name,
        "description": sentence(column(table, field.name)[1]),
        "dataType": _TYPES[field.type.value_type if is_list else field.type],
        "source": {"fileObject": {"@id": f"{table}-file"}, "extract": {"column": field.name}},
    }
    if is_list:
        described |= {"isArray": True, "arrayShape": "-1"}
    if (table, field.name) == ("questions", "sequence"):
        described["references"] = {"field": {"@id": "sequences/sequence"}}
    return described


def sentence(text: str) -> str:
    """Return the meaning of a column as a sentence: with a capital letter and a full stop."""
    return text[:1].upper() + text[1:] + "."
