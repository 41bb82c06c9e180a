"""Pictures of a store in a notebook: a question with its panoramas, and the people in the rows of a query."""

from __future__ import annotations

import base64
import contextlib
import html
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import pyarrow as pa

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.crops import contact_sheet, crops_of_rows, png
from jrdb_avr.queries import store as stores
from jrdb_avr.queries.display import MAX_ROWS, Displayed, Tables
from jrdb_avr.queries.questions import QuestionRow, read_question_rows, read_sequences
from jrdb_avr.schema.errors import InputError, ObserveError, did_you_mean


class Store(stores.Store):
    """Store in a folder, with pictures for notebooks. The constructor checks nothing.

    If nothing is loaded, `manifest()` raises StoreError.
    """

    def cypher(self, query: str, /, **params: Any) -> Any:
        """Run a Cypher statement on the graph. Return an Arrow table, as `QueryRows` that can show crops."""
        return QueryRows(self, super().cypher(query, **params), params)

    def sql(self, query: str, /, **params: Any) -> Any:
        """Run a SQL statement on the Parquet tables. Return an Arrow table, as `QueryRows` that can show crops."""
        return QueryRows(self, super().sql(query, **params), params)

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
        named = {int(frame) for frame in re.findall(r"\bframe (\d+)", self.question)}
        items = "".join(f"<li>{html.escape(choice)}</li>" for choice in self.choices)
        parts = [f"<p><b>{html.escape(self.question)}</b></p><ol>{items}</ol>"]
        # Without panoramas, the text is displayed alone.
        with contextlib.suppress(ObserveError):
            for frame in sorted(named & {*info.frames}) or info.frames[:: max(1, len(info.frames) // 2)]:
                data = base64.b64encode(png(Observer(self.store).panorama(self.sequence, frame)[::4, ::4])).decode()
                parts.append(f'<p><img alt="" src="data:image/png;base64,{data}"><br>frame {frame}</p>')
        return "".join(parts)


class QueryRows(Displayed):
    """Rows of a query. Each attribute of the Arrow table works, such as `to_pandas()`."""

    def __init__(self, store: stores.Store, table: pa.Table, params: Mapping[str, Any]) -> None:
        self.store, self.table, self.params = store, table, params

    def __getattr__(self, name: str) -> Any:
        return getattr(vars(self).get("table"), name)

    def __getitem__(self, key: Any) -> Any:
        return self.table[key]

    def show(self) -> None:
        """Display a crop of each row in a notebook. Raise InputError if the rows name no sequence, frame and box."""
        from IPython.display import Image as Picture
        from IPython.display import display

        crops = crops_of_rows(self.store, self.table.to_pylist(), self.params)
        display(Picture(data=png(contact_sheet([image for _, image in crops]))))

    def _summary(self) -> str:
        return f"{self.num_rows} rows of {', '.join(self.table.column_names)}"

    def _tables(self) -> Tables:
        return {"Rows": self.table.slice(0, MAX_ROWS).to_pylist()}
