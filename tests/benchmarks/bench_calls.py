"""The harness's own time per model call: `python tests/benchmarks/bench_calls.py [--smallest]`.

A server in another process answers at once; 64 questions are in flight, each makes a number of looks and answers.
Printed: wall time per call against the bar of 8 ms + 8 ms per megabyte of request. Crops come from one array in memory,
so no panorama is decoded; making each crop a JPEG, writing requests, reading replies, the cache and the journal count.

ReAct makes a look in each turn. `bench_world.py` measures the world model of the agent.
"""

import argparse
import asyncio
import contextlib
import json
import multiprocessing
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.engine.run.answering import answer_all
from jrdb_avr.engine.run.journal import Journal
from jrdb_avr.engine.run.methods import make_method
from jrdb_avr.schema.method import Observation, Question, SequenceInfo
from jrdb_avr.schema.panorama import FOV_DEG, crop_left

IN_FLIGHT = 64
ROUNDS = 8
"""Questions per place in flight: the first ones begin and end together, as few of the two thousand of a run do."""


class Instant(asyncio.Protocol):
    """Answers each request as soon as it is whole; looks until the request holds `looks` images."""

    def __init__(self, looks, sizes, reply):
        self.looks, self.sizes, self.reply, self.data, self.need = looks, sizes, reply, bytearray(), None

    def connection_made(self, transport):
        self.transport = transport

    def data_received(self, data):
        self.data += data
        if self.need is None and (end := self.data.find(b"\r\n\r\n")) >= 0:
            head = bytes(self.data[:end]).lower()
            self.need = end + 4 + int(head.partition(b"content-length:")[2].partition(b"\r\n")[0])
        if self.need is not None and len(self.data) >= self.need:
            turn = self.reply(bytes(self.data), self.looks)
            self.sizes.value += len(self.data)
            self.data, self.need = self.data[self.need :], None
            message = {"role": "assistant", "content": json.dumps(turn)}
            body = {"model": "x", "choices": [{"index": 0, "finish_reason": "stop", "message": message}]}
            text = json.dumps(body).encode()
            self.transport.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(text) + text)


def react(data, looks):
    images = data.count(b"data:image")
    if images < looks:
        return {"action": "observe", "frame_id": f"{images * 15:06d}", "angle_deg": 180}
    box = [{"frame_id": f"{(images - 1) * 15:06d}", "bbox": [1, 2, 3, 4]}]
    return {"action": "answer", "answer": 1, "evidence_bboxes": box}


def serve(looks, port, sizes, reply):
    async def run():
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: Instant(looks, sizes, reply), "127.0.0.1", 0, backlog=256)
        port.value = server.sockets[0].getsockname()[1]
        await server.serve_forever()

    asyncio.run(run())


def crop_like_array():
    """480 x 480 x 3, as hard to compress as a street scene: smooth shapes and a little noise (about 70 KB as JPEG)."""
    rng = np.random.default_rng(0)
    smooth = np.kron(rng.integers(40, 215, (30, 30, 3)), np.ones((16, 16, 1)))
    return np.clip(smooth + rng.normal(0, 7, (480, 480, 3)), 0, 255).astype(np.uint8)


def measure(looks, questions):
    """Calls, megabytes per request, milliseconds of wall and of processor per call."""
    context = multiprocessing.get_context("spawn")
    port, sizes = context.Value("i", 0), context.Value("q", 0)
    server = context.Process(target=serve, args=(looks, port, sizes, react), daemon=True)
    server.start()
    while not port.value:
        time.sleep(0.01)
    image = crop_like_array()
    info = SequenceInfo("s", 15.0, 1000, tuple(range(0, 1000, 15)))

    def observe(sequence, frame_index, angle_deg):
        frame, left = frame_index, int(crop_left(angle_deg))
        return Observation(sequence, frame, frame / 15, angle_deg, FOV_DEG, left, image)

    def panorama(sequence, frame_index):
        raise AssertionError("no panorama is asked for")

    # Different texts: equal requests would be answered from the cache.
    shape = ("a", "b"), "multiple_choice"
    asked = [Question(f"{i:016x}", "s", f"Question {i}?", *shape) for i in range(questions)]
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        client = Client(f"http://127.0.0.1:{port.value}/v1", "x", cache=Path(folder) / "calls.jsonl")
        method = make_method("react", client, CONTRACT)
        sizes.value = 0
        journal = stack.enter_context(
            Journal(Path(folder) / "journal", {own.question_id: own.sequence for own in asked})
        )
        started, used = time.perf_counter(), time.process_time()
        answer_all(method, asked, {"s": info}, observe, panorama, journal, IN_FLIGHT)
        seconds, cpu = time.perf_counter() - started, time.process_time() - used
        entries = journal.finished.values()
        assert {entry.prediction["status"] for entry in entries} == {"answered"}
        calls = sum(entry.prediction["n_model_calls"] for entry in entries)
    server.terminate()
    return calls, sizes.value / calls / 1e6, seconds / calls * 1000, cpu / calls * 1000


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smallest", action="store_true", help="8 questions, without a bar")
    smallest = parser.parse_args().smallest
    print("looks   calls   MB/request   ms/call   CPU ms/call    bar   share of the bar")
    worst = 0.0
    for looks in (4,) if smallest else (1, 4, 12, 24):
        calls, megabytes, ms, cpu = measure(looks, 8 if smallest else ROUNDS * IN_FLIGHT)
        bar = 8 + 8 * megabytes
        worst = max(worst, ms / bar)
        print(f"{looks:5} {calls:7} {megabytes:12.3f} {ms:9.2f} {cpu:13.2f} {bar:6.1f} {ms / bar:12.2f}")
    sys.exit(worst > 1 and not smallest)


if __name__ == "__main__":
    main()
