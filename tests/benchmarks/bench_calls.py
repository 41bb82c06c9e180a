"""The harness's own time per model call: `python tests/benchmarks/bench_calls.py`.

A server in another process answers at once; 64 questions are in flight, each makes a number of looks and answers.
Printed: wall time per call against the bar of 8 ms + 8 ms per megabyte of request. Crops come from one array in memory,
so no panorama is decoded; making each crop a JPEG, writing requests, reading replies, the cache and the journal count.
"""

import asyncio
import json
import multiprocessing
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from jrdb_avr.agent.client import Client
from jrdb_avr.agent.messages import Message
from jrdb_avr.agent.react import ReAct
from jrdb_avr.engine.runs import Journal, ask_all
from jrdb_avr.schema.method import Observation, Question, SequenceInfo
from jrdb_avr.schema.panorama import FOV_DEG, crop_left

QUESTIONS = 128
IN_FLIGHT = 64


class Instant(asyncio.Protocol):
    """Answers each request as soon as it is whole; looks until the request holds `looks` images."""

    def __init__(self, looks, sizes):
        self.looks, self.sizes, self.data, self.need = looks, sizes, bytearray(), None

    def connection_made(self, transport):
        self.transport = transport

    def data_received(self, data):
        self.data += data
        if self.need is None and (end := self.data.find(b"\r\n\r\n")) >= 0:
            head = bytes(self.data[:end]).lower()
            self.need = end + 4 + int(head.partition(b"content-length:")[2].partition(b"\r\n")[0])
        if self.need is not None and len(self.data) >= self.need:
            images = self.data.count(b"data:image")
            self.sizes.value += len(self.data)
            self.data, self.need = self.data[self.need :], None
            if images < self.looks:
                turn = {"action": "observe", "frame_id": f"{images * 15:06d}", "angle_deg": 180}
            else:
                box = [{"frame_id": f"{(images - 1) * 15:06d}", "bbox": [1, 2, 3, 4]}]
                turn = {"action": "answer", "answer": 1, "evidence_bboxes": box}
            message = {"role": "assistant", "content": json.dumps(turn)}
            body = {"model": "x", "choices": [{"index": 0, "finish_reason": "stop", "message": message}]}
            text = json.dumps(body).encode()
            self.transport.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(text) + text)


def serve(looks, port, sizes):
    async def run():
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: Instant(looks, sizes), "127.0.0.1", 0, backlog=256)
        port.value = server.sockets[0].getsockname()[1]
        await server.serve_forever()

    asyncio.run(run())


def crop_like_array():
    """480 x 480 x 3, as hard to compress as a street scene: smooth shapes and a little noise (about 70 KB as JPEG)."""
    rng = np.random.default_rng(0)
    smooth = np.kron(rng.integers(40, 215, (30, 30, 3)), np.ones((16, 16, 1)))
    return np.clip(smooth + rng.normal(0, 7, (480, 480, 3)), 0, 255).astype(np.uint8)


def measure(looks):
    context = multiprocessing.get_context("spawn")
    port, sizes = context.Value("i", 0), context.Value("q", 0)
    server = context.Process(target=serve, args=(looks, port, sizes), daemon=True)
    server.start()
    while not port.value:
        time.sleep(0.01)
    image = crop_like_array()
    info = SequenceInfo("s", 15.0, 1000, tuple(range(0, 1000, 15)))

    def observe(sequence, frame, angle):
        return Observation(sequence, frame, f"{frame:06d}", frame / 15, angle, FOV_DEG, int(crop_left(angle)), image)

    def panorama(sequence, frame):
        raise AssertionError("no panorama is asked for")

    # Different texts: equal requests would be answered from the cache.
    shape = ("a", "b"), "multiple_choice"
    asked = [Question(f"{i:016x}", "s", "f", "t", f"Question {i}?", *shape) for i in range(QUESTIONS)]
    with tempfile.TemporaryDirectory() as folder:
        client = Client(f"http://127.0.0.1:{port.value}/v1", "x", cache=Path(folder) / "calls")
        client.ask([Message("user", ("hello",))])
        sizes.value = 0
        with Journal(Path(folder) / "journal.jsonl") as journal:
            started = time.perf_counter()
            ask_all(ReAct(client), asked, {"s": info}, observe, panorama, journal, IN_FLIGHT)
            seconds = time.perf_counter() - started
            assert all(entry.prediction["status"] == "answered" for entry in journal.finished.values())
    server.terminate()
    calls = QUESTIONS * (looks + 1)
    megabytes = sizes.value / calls / 1e6
    return calls, megabytes, seconds / calls * 1000


def main():
    print("looks   calls   MB/request   ms/call    bar   share of the bar")
    worst = 0.0
    for looks in (1, 4, 12, 24):
        calls, megabytes, ms = measure(looks)
        bar = 8 + 8 * megabytes
        worst = max(worst, ms / bar)
        print(f"{looks:5} {calls:7} {megabytes:12.3f} {ms:9.2f} {bar:6.1f} {ms / bar:12.2f}")
    sys.exit(worst > 1)


if __name__ == "__main__":
    main()
