"""Files below a URL, by `pyarrow.fs` or, for schemes that it does not speak, by fsspec where that is installed.

Names in a listing are untrusted: only plain ones are returned, so that no file is written outside a folder that it is
fetched into. Whatever a file system raises becomes a StoreError of one line.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qsl, urlsplit, urlunsplit

from jrdb_avr.queries.files import write_atomic
from jrdb_avr.schema.errors import AvrError, InputError, StoreError

_PLAIN: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ +@=-]{0,199}")

_OTHER: Final = ("PreconditionFailed", "ConditionalRequestConflict", "NoSuchKey")
"""Codes of S3's errors where a file is not the one that a condition names."""


def child_url(url: str, path: str) -> str:
    """The URL of a file or folder below one."""
    parts = urlsplit(url)
    return urlunsplit(parts._replace(path=f"{parts.path.rstrip('/')}/{path}"))


def path_below(url: str, parent: str) -> str | None:
    """The path from one URL down to another; None where that lies elsewhere."""
    place, base = urlsplit(url), urlsplit(parent)
    folder = f"{base.path.rstrip('/')}/"
    inside = place._replace(path="") == base._replace(path="") and place.path.startswith(folder)
    return place.path.removeprefix(folder) if inside else None


def is_plain_path(name: str) -> bool:
    """Whether all parts of a relative path are plain names: none is hidden, empty, or leads upwards."""
    return all(_PLAIN.fullmatch(part) for part in name.split("/"))


class RemoteFolder:
    """The folder at a URL. Making one checks the URL and reaches nothing; all methods raise StoreError."""

    def __init__(self, url: str) -> None:
        """Raises InputError for a URL that holds a key."""
        if urlsplit(url).password is not None:
            raise InputError("keep keys out of the URL: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY", field="store")
        self.url = url.rstrip("/")

    def files(self, part: str, *, below: bool = True) -> dict[str, str]:
        """The files of a folder "NAME/", of the whole ("") or of one file, each with its size and time of change.

        `below`: also those in its folders.
        """
        from pyarrow.fs import FileSelector, FileType

        with self._reached() as (system, root):
            place = f"{root}/{part}".rstrip("/")
            asked: Any = [place]
            if not part or part.endswith("/"):
                asked = FileSelector(place, recursive=below, allow_not_found=True)
            found = system.get_file_info(asked)
        named = ((info.path.removeprefix(f"{root}/"), info) for info in found if info.type == FileType.File)
        return {
            name: f"{info.size} {info.mtime_ns}"
            for name, info in named
            if name.startswith(part) and is_plain_path(name)
        }

    def tag(self, name: str) -> str | None:
        """The server's tag of a file's content; None where it has none."""
        with self._reached() as (system, root), system.open_input_stream(f"{root}/{name}") as file:
            found = {key.lower(): value for key, value in (file.metadata() or {}).items()}.get("etag")
            return None if found is None else bytes(found).decode()

    def read(self, name: str) -> bytes:
        """The content of a file."""
        with self._reached() as (system, root), system.open_input_stream(f"{root}/{name}") as file:
            content: bytes = file.read()
            return content

    def begins(self, path: Path, name: str) -> bool:
        """Whether a file here begins with the content of a file there."""
        with (
            self._reached() as (system, root),
            system.open_input_stream(f"{root}/{name}") as there,
            path.open("rb") as here,
        ):
            while piece := there.read(1 << 20):
                if here.read(len(piece)) != piece:
                    return False
        return True

    def fetch(self, name: str, path: Path) -> None:
        """Write a file to a path here, whole."""
        from pyarrow.fs import LocalFileSystem, copy_files

        def write(temporary: Path) -> None:
            with self._reached() as (system, root):
                here = LocalFileSystem()
                copy_files(f"{root}/{name}", str(temporary), source_filesystem=system, destination_filesystem=here)

        write_atomic(path, write)

    def send(self, path: Path, name: str) -> None:
        """Write a file here to the URL, whole."""
        from pyarrow.fs import LocalFileSystem, copy_files

        with self._reached() as (system, root):
            place = f"{root}/{name}"
            if system.type_name not in ("s3", "gcs"):
                system.create_dir(place.rpartition("/")[0], recursive=True)
            # A folder shows a file while it is written; elsewhere one is there when it is whole.
            first = f"{place}.part" if system.type_name == "local" else place
            copy_files(str(path), first, source_filesystem=LocalFileSystem(), destination_filesystem=system)
            if first != place:
                system.move(first, place)

    def replace(self, name: str, data: bytes, tag: str | None) -> str | None:
        """Write a small file if its tag still is `tag`, None for no such file, in one step of the server.

        Returns its new tag, or None where it is another one by now. Returns "" and writes nothing where no condition
        can be set: elsewhere than on S3, without boto3, and on servers that know none.
        """
        parts = urlsplit(self.url)
        if parts.scheme != "s3" or importlib.util.find_spec("boto3") is None:
            return ""
        import boto3
        from botocore.exceptions import ClientError

        options = dict(parse_qsl(parts.query))
        place = options.get("endpoint_override")
        endpoint = f"{options.get('scheme', 'https')}://{place}" if place else None
        condition = {"IfNoneMatch": "*"} if tag is None else {"IfMatch": tag}
        with self._reached() as (_, root):
            bucket, _, key = f"{root}/{name}".partition("/")
            client = boto3.client("s3", region_name=options.get("region"), endpoint_url=endpoint)
            try:
                written = client.put_object(Bucket=bucket, Key=key, Body=data, **condition)
            except ClientError as error:
                if error.response["Error"]["Code"] in _OTHER:
                    return None
                if error.response["Error"]["Code"] == "NotImplemented":
                    return ""
                raise
            return str(written["ETag"])

    def delete(self, name: str) -> None:
        """Delete a file."""
        with self._reached() as (system, root):
            system.delete_file(f"{root}/{name}")

    @contextlib.contextmanager
    def _reached(self) -> Iterator[tuple[Any, str]]:
        try:
            yield _connect(self.url)
        except AvrError:
            raise
        except Exception as error:
            # Any library's error.
            reason = (str(error).splitlines() or [type(error).__name__])[0][:300]
            raise StoreError(
                f"cannot reach {self.url}: {reason}; check the address, the keys and the network"
            ) from None


@functools.lru_cache
def _connect(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    from pyarrow import ArrowInvalid
    from pyarrow.fs import FileSystem

    try:
        system, root = FileSystem.from_uri(url)
    except ArrowInvalid as error:
        if "Unrecognized filesystem type" not in str(error):
            raise
        system, root = FileSystem.from_uri(f"fsspec+{url}")
    return system, root.rstrip("/")
