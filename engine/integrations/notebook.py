"""Pictures of a store in a notebook: a question with its panoramas, and the people in the rows of a query."""

from __future__ import annotations

import base64
import contextlib
import functools
import html
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.observe.overlay import draw_people
from jrdb_avr.queries import store as stores
from jrdb_avr.queries.display import MAX_ROWS, Displayed, Tables
from jrdb_avr.queries.questions import QuestionRow, read_question_rows, read_sequences
from jrdb_avr.schema.errors import InputError, ObserveError, did_you_mean
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import CROP, center_angle

_SHRINK: Final = 4
"""A strip shows each fourth pixel of a panorama."""
_SHEET: Final = 60
"""Maximum number of crops of a contact sheet."""


class Store(stores.Store):
    """Store in a folder, with pictures for notebooks. The constructor checks nothing.

    If nothing is loaded, `manifest()` raises StoreError.
    """

    def cypher(self, query: str, /, **params: Any) -> Any:
        """Run a Cypher statement on the graph. Return an Arrow table, as `Rows` that can show crops."""
        return Rows(self, super().cypher(query, **params), params)

    def sql(self, query: str, /, **params: Any) -> Any:
        """Run a SQL statement on the Parquet tables. Return an Arrow table, as `Rows` that can show crops."""
        return Rows(self, super().sql(query, **params), params)

    def question(self, question_id: str) -> StoredQuestion:
        """Return a question of the store. Its function `show` displays it in a notebook, with panoramas.

        Args:
            question_id: The id of the question.

        Returns:
            The question.

        Raises:
            InputError: If the store has no question with this id.
            StoreError: If the store has no questions.
        """
        rows = {row.question_id: row for row in read_question_rows(self)}
        if question_id not in rows:
            raise InputError(f"no question {question_id[:40]!r}{did_you_mean(question_id, rows)}", field="question_id")
        return StoredQuestion(**asdict(rows[question_id]), store=self)


@dataclass(frozen=True)
class StoredQuestion(QuestionRow):
    """Question of a store. A notebook displays its text, its choices, and the panoramas of the frames in the text.

    If the text names no frame with a panorama, the first, middle and last panoramas are displayed.
    """

    store: Store = field(repr=False)

    def show(self) -> None:
        """Display the question in a notebook."""
        from IPython.display import display

        display(self)

    def _repr_html_(self) -> str:
        info = read_sequences(self.store)[self.sequence]
        observer = Observer(self.store.manifest().image_root, [info])
        named = {int(frame) for frame in re.findall(r"\bframe (\d+)", self.question)}
        parts = [f"<p><b>{html.escape(self.question)}</b></p><ol>"]
        parts += [f"<li>{html.escape(choice)}</li>" for choice in self.choices] + ["</ol>"]
        # Without panoramas, the text is displayed alone.
        with contextlib.suppress(ObserveError):
            for frame in sorted(named & {*info.frames}) or info.frames[:: max(1, len(info.frames) // 2)]:
                strip = png(observer.panorama(self.sequence, frame)[::_SHRINK, ::_SHRINK])
                parts.append(f'<p><img alt="" src="data:image/png;base64,{base64.b64encode(strip).decode()}"><br>')
                parts.append(f"frame {frame}, {frame / info.fps:.1f} s</p>")
        return "".join(parts)


class Rows(Displayed):
    """Rows of a query. Each attribute of the Arrow table works, such as `to_pandas()`."""

    def __init__(self, store: stores.Store, table: pa.Table, params: Mapping[str, Any]) -> None:
        self.store, self.table, self.params = store, table, params

    def __getattr__(self, name: str) -> Any:
        return getattr(vars(self).get("table"), name)

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def __getitem__(self, key: Any) -> Any:
        return self.table[key]

    def show(self) -> None:
        """Display a crop of each row in a notebook. Raise InputError if the rows name no sequence, frame and box."""
        from IPython.display import Image as Picture
        from IPython.display import display

        crops = crops_of_rows(self.store, self.table.to_pylist(), self.params)
        display(Picture(data=png(contact_sheet([image for _, image in crops]))))

    def _summary(self) -> str:
        return f"{len(self)} rows of {', '.join(self.table.column_names)}"

    def _tables(self) -> Tables:
        return {"Rows": self.table.slice(0, MAX_ROWS).to_pylist()}


def crops_of_rows(
    store: stores.Store, rows: Iterable[Mapping[str, Any]], params: Mapping[str, Any]
) -> Iterator[tuple[str, Image]]:
    """Yield a crop of each row that names a person in a frame, with the box drawn.

    Args:
        store: The store, with panoramas.
        rows: Rows with `sequence`, `frame`, and `track` or the box `x`, `y`, `w` and `h` in stitched pixels.
        params: Values for columns that the rows lack.

    Yields:
        A name for a file, with the number of the row from 1, and the crop. A row without a box in its frame has none.

    Raises:
        InputError: If a row lacks a column.
        ObserveError: If a frame has no panorama.
    """
    observer = Observer(store)

    @functools.cache
    def boxes(sequence: str) -> dict[tuple[int, int], dict[str, Any]]:
        return {(row["frame"], row["track"]): row for row in store.interval("sightings", sequence).to_pylist()}

    for n, row in enumerate(({**params, **row} for row in rows), 1):
        boxed = {*"xywh"} <= row.keys()
        if not {"sequence", "frame"} <= row.keys() or not (boxed or "track" in row):
            raise InputError("crops need rows with sequence, frame, and track or x, y, w, h: return these columns")
        box = {"track": n, "clear": True, "pose": None, "cluster": None, **row}
        if not boxed:
            box = boxes(row["sequence"]).get((row["frame"], row["track"]), {"x": None})
        if box["x"] is not None:
            seen = observer(row["sequence"], row["frame"], center_angle(box["x"], box["w"]))
            name = f"{n:04d}-{seen.sequence}-{seen.frame_index:06d}.png"
            yield name, draw_people(seen.image, [box], left=seen.left)


def contact_sheet(crops: Sequence[Image]) -> Image:
    """Return the first 60 crops at half size, six in a row. Raise InputError if there are no crops."""
    import cv2

    if not crops:
        raise InputError("no row names a person with a box in its frame")
    halves = [cv2.resize(crop, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for crop in crops[:_SHEET]]
    halves += [np.zeros((CROP // 2, CROP // 2, 3), np.uint8)] * (-len(halves) % 6)
    return np.vstack([np.hstack(halves[at : at + 6]) for at in range(0, len(halves), 6)])


def png(image: Image) -> bytes:
    """Return an RGB image as a PNG file."""
    import cv2

    return bytes(cv2.imencode(".png", image[..., ::-1])[1])
