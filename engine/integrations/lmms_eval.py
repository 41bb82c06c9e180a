"""The methods with a fixed context as tasks of lmms-eval: what `export --lmms-eval` writes, and what that calls.

    DIR/jrdb_avr_monolithic.yaml, jrdb_avr_chain_of_thought.yaml
    DIR/utils.py                   the functions that both name, which are those of `FixedContextTask`
    DIR/questions/*.parquet        the public questions and sequences

The method itself makes the messages and reads the replies: it is played from the start with the replies so far, up to
its next call. So nothing here repeats a prompt or a rule. There are no answers in this process: predictions leave it as
lines of JSON, which `jrdb-avr score --jsonl` scores.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NoReturn

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.agent.methods.attempt import PANORAMAS, uniform_frames
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.messages import Message, Picture
from jrdb_avr.agent.model.options import DEFAULTS
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.engine.report.prediction_lines import line_of
from jrdb_avr.engine.run.bench import Bench, find_images
from jrdb_avr.engine.run.methods import make_method
from jrdb_avr.queries.files import new_folder, write_bytes
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Prediction
from jrdb_avr.schema.tables import CANARY, QUESTIONS

Doc = Mapping[str, Any]
Pictured = list[dict[str, Any]]

TASKS: Final = {"monolithic": "generate_until", "chain-of-thought": "generate_until_multi_round"}
"""The methods, and the kind of task that each is. Many models of lmms-eval only know the first kind, in which a reply
that cannot be read is not asked for again."""


class FixedContextTask:
    """A method as the functions of a task; `picture` makes what lmms-eval takes for an image from the bytes of a JPEG.

    folder: with the public questions; images: with a folder of panoramas per sequence; model: its name, by which boxes
    are read under its convention.
    """

    def __init__(
        self, method: str, folder: str | Path, images: str | Path, model: str, picture: Callable[[bytes], Any]
    ) -> None:
        self._name, self._picture = method, picture
        self._convention = convention_of(model)
        self._bench = Bench.open(Store(folder), images=images)

    def doc_to_visual(self, doc: Doc) -> list[Any]:
        """The panoramas of a question."""
        task = self._bench.task(doc["question_id"])
        frames = uniform_frames(task.sequence.frames, PANORAMAS)
        return [self._picture(task.panorama(task.question.sequence, frame).jpeg) for frame in frames]

    def doc_to_text(
        self,
        doc: Doc,
        lmms_eval_specific_kwargs: object = None,
        previous_output: Sequence[str] = (),
        round_idx: int | None = None,
        previous_round_info: object = None,
    ) -> Any:
        """The text of a call, for models that get the pictures before it.

        In later rounds (pictures, text, whether it is over, replies so far, None).
        """
        messages = self._next_call(doc, previous_output or ())
        if messages is None:
            return None, None, True, previous_output, None
        parts = [part for message in messages for part in message.parts if isinstance(part, str)]
        text = "\n\n".join(parts)
        return (self.doc_to_visual(doc), text, False, previous_output, None) if round_idx else text

    def doc_to_messages(
        self,
        doc: Doc,
        lmms_eval_specific_kwargs: object = None,
        previous_output: Sequence[str] = (),
        round_idx: int | None = None,
        previous_round_info: object = None,
    ) -> Any:
        """The messages of a call, each picture in its place; in later rounds (messages, whether it is over, replies so
        far, None)."""
        messages = self._next_call(doc, previous_output or ())
        if messages is None:
            return None, True, previous_output, None
        pictured = [{"role": message.role, "content": self._content(message)} for message in messages]
        return (pictured, False, previous_output, None) if round_idx else pictured

    def process_results(self, doc: Doc, results: Sequence[Any]) -> dict[str, Any]:
        """Read the replies: whether answer and box could be read (0 or 1), and the prediction as a line."""
        replies = [results[0]] if isinstance(results[0], str) else list(results[0])
        prediction = self._play(doc, _Replies(replies, _no_more))
        line = line_of(doc["question_id"], prediction).decode()
        return {"readable": int(prediction.status == "answered"), "predictions": line}

    def write_predictions(self, results: Sequence[str], args: Any = None) -> int:
        """Write the lines of all questions beside lmms-eval's own output; returns how many they are."""
        folder = Path(getattr(args, "output_path", None) or ".") / "submissions"
        write_bytes(folder / f"{task_name(self._name)}.jsonl", "".join(results).encode())
        return len(results)

    def _next_call(self, doc: Doc, replies: Sequence[str]) -> Sequence[Message] | None:
        """The messages of the method's next call; None where it has ended."""
        try:
            self._play(doc, _Replies(replies, _stop))
        except _NextCall as call:
            return call.messages
        return None

    def _play(self, doc: Doc, chat: _Replies) -> Prediction:
        method = make_method(self._name, chat, self._convention)
        return method.answer(self._bench.task(doc["question_id"]))

    def _content(self, message: Message) -> Pictured:
        return [
            {"type": "image", "url": self._picture(part.data)}
            if isinstance(part, Picture)
            else {"type": "text", "text": part}
            for part in message.parts
        ]


class _NextCall(Exception):  # noqa: N818 - it carries the call out of the method, and nothing is wrong
    def __init__(self, messages: Sequence[Message]) -> None:
        self.messages = messages


def _stop(messages: Sequence[Message]) -> NoReturn:
    raise _NextCall(messages)


def _no_more(messages: Sequence[Message]) -> NoReturn:
    raise DecodeError("the last reply could not be used, and lmms-eval asked for no other")


class _Replies:
    """A chat with these replies; `after` is called with the messages of the call that has none."""

    def __init__(self, replies: Sequence[str], after: Callable[[Sequence[Message]], NoReturn]) -> None:
        self._replies, self._after = iter(replies), after

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        reply = next(self._replies, None)
        return self._after(messages) if reply is None else Reply(reply, finish_reason="stop")


# -- the folder -------------------------------------------------------------------------------------------------------


def task_name(method: str) -> str:
    """The name of a method's task."""
    return f"jrdb_avr_{method.replace('-', '_')}"


def export_tasks(store: Store | str | Path, folder: str | Path) -> int:
    """Write the tasks of a store's questions that have panoramas into a new folder; returns how many questions.

    Raises StoreError where there are no questions or panoramas, InputError where the folder holds something.
    """
    store, folder = Store.of(store), Path(folder)
    store.refuse_training()
    images, bench = find_images(store, None), Bench.open(store)
    ids = pa.array([question.question_id for question in bench.questions])
    questions = store.questions("questions")
    tables = {
        "questions": questions.filter(pc.is_in(questions["question_id"], ids)),
        "sequences": store.questions("sequences"),
    }
    template = files(__package__).joinpath("lmms_utils.txt").read_text("utf-8")
    with new_folder(folder) as made:
        for name, table in tables.items():
            write_table(Store(made).question_path(name), table, QUESTIONS[name], {"canary": CANARY})
        write_bytes(made / "utils.py", template.replace("IMAGES_OF_THE_STORE", repr(images)).encode())
        for method, kind in TASKS.items():
            write_bytes(made / f"{task_name(method)}.yaml", _task(method, kind).encode())
    return len(ids)


def _task(method: str, kind: str) -> str:
    """The text of a task file for lmms-eval. Written by hand, as no YAML library here writes its tag `!function`."""
    prefix = f"!function utils.{method.replace('-', '_')}"
    return f"""\
# Written by `jrdb-avr export --lmms-eval`; for lmms-eval 0.7 and later.
task: {task_name(method)}
dataset_path: parquet
dataset_kwargs:
  data_files:
    test: questions/questions.parquet
test_split: test
output_type: {kind}
doc_to_visual: {prefix}_doc_to_visual
doc_to_text: {prefix}_doc_to_text
doc_to_messages: {prefix}_doc_to_messages
doc_to_target: answer_mode  # the answers are elsewhere
process_results: {prefix}_process_results
generation_kwargs:
  max_new_tokens: {DEFAULTS.max_tokens}
  temperature: 0
  do_sample: false
  until: []
metric_list:
  - metric: readable
    aggregation: mean
    higher_is_better: true
  - metric: predictions
    aggregation: {prefix}_write_predictions
    higher_is_better: true
metadata:
  version: 1
"""
