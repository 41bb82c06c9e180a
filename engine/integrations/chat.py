"""Conversations of a run as messages with pictures, which trainers of vision-language models read.

    metadata.jsonl   one line per model call: question_id, messages, images_file_names
    pictures/        the crops and panoramas of the messages

`datasets.load_dataset("imagefolder", data_dir=DIR)` returns the columns `messages` and `images`. The last message of a
line is the reply of the model. The messages before it are the request, with a part of type `image` for each picture.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import msgspec

from jrdb_avr.agent.model.messages import picture_of
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.queries.files import new_folder, write_bytes
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.errors import StoreError, warn


class _Message(msgspec.Struct):
    role: str
    content: str


class _Reply(msgspec.Struct):
    content: str


def export_chat(store: Store, run_id: str, folder: Path) -> int:
    """Write the conversations of a run. An AvrWarning says if the questions are a benchmark.

    Args:
        store: The store of the run, with the panoramas that the run used.
        run_id: The id of the run.
        folder: The folder to write. It must be missing or empty.

    Returns:
        The number of lines.

    Raises:
        StoreError: If the run is missing or unfinished, or if it has no model call.
        InputError: If the folder is not empty.
        ObserveError: If a picture of the run cannot be made again.
    """
    path, manifest = store.run_path(run_id) / "steps.parquet", read_run_manifest(store, run_id)
    steps = [step for step in read_table(path).to_pylist() if step["kind"] == "model"] if path.exists() else []
    if not steps:
        raise StoreError(f"run {run_id} has no model calls: finish it by 'evaluate --resume', or name a run of a model")
    if not store.training_set():
        warn(f"{store.path} holds a benchmark, which must not be trained on (see 'generate --profile train')")
    bench = Bench(store, opaque="opaque" in manifest.settings)
    names = "|".join(map(re.escape, bench.sequences))
    angle = r"panorama|-?[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?"
    picture = re.compile(rf"\n?^\[image ({names}) ([0-9]{{6}}) ({angle})\]$\n?", re.MULTILINE)
    lines = []
    with new_folder(folder) as made:
        (made / "pictures").mkdir()
        for step in steps:
            request, reply = (step[name] for name in ("request", "response"))
            try:
                messages = msgspec.json.decode(request, type=list[_Message])
                messages.append(_Message("assistant", msgspec.json.decode(reply, type=_Reply).content))
            except msgspec.MsgspecError as error:
                raise StoreError(
                    f"{path}: step {step['step']} of {step['question_id']} is not a chat: {error}"
                ) from None
            line: dict[str, Any] = {"question_id": step["question_id"], "messages": [], "images_file_names": []}
            for message in messages:
                # The pattern has three groups, so that each fourth text is outside the pictures.
                texts = picture.split(message.content) if message.role != "assistant" else [message.content]
                parts = [{"type": "text", "text": texts[0]}] if texts[0] else []
                for sequence, frame, angle, text in zip(*(iter(texts[1:]),) * 4, strict=True):
                    line["images_file_names"].append(_write_picture(made, bench, sequence, int(frame), angle))
                    parts += [{"type": "image"}, *([{"type": "text", "text": text}] if text else [])]
                line["messages"].append({"role": message.role, "content": parts})
            lines.append(msgspec.json.encode(line) + b"\n")
        write_bytes(made / "metadata.jsonl", b"".join(lines))
    return len(lines)


def _write_picture(folder: Path, bench: Bench, sequence: str, frame: int, angle: str) -> str:
    """Write a picture of a transcript if the folder lacks it, and return its path in the folder."""
    name = f"pictures/{sequence}_{frame:06d}_{angle}.jpg"
    if not (folder / name).exists():
        see, whole = bench.observer, angle == "panorama"
        shown = see.stored(sequence, frame) if whole else see(sequence, frame, float(angle))
        write_bytes(folder / name, picture_of(shown).data)
    return name
