"""Mutated replies of models, read by every method: each question ends in a prediction or in an error of the tree.

A method is played with a chat that answers by the JSON Schema of each request, and of most replies something is wrong:
in the text, in the object that it holds, or in the body that a server sends it in.
"""

from __future__ import annotations

import functools
import json
import math
from pathlib import Path
from random import Random
from typing import get_args

import httpx2
import limits
import numpy as np
from mutate import mutate

from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.prompts import PromptSet
from jrdb_avr.agent.model.reply import thinking_text
from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.engine.run.methods import CHATS, METHODS, WORLD_METHODS, make_method
from jrdb_avr.engine.run.options import MethodOptions
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.answers import AnswerMode
from jrdb_avr.schema.errors import AvrError
from jrdb_avr.schema.method import Observation, Panorama, Prediction, Question, SequenceInfo, Task
from jrdb_avr.schema.panorama import FOV_DEG, crop_left

MODES: tuple[AnswerMode, ...] = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")
CHOICES = ("walking", "standing", "sitting", "lying")
FRAMES = tuple(range(0, 301, 15))
MODELS = ("contract", "gemma-4-27b-it", "qwen3-vl-8b", "qwen3.5-9b", "qwen3-vl-8b-thinking")
GAMES_PER_WORLD = 40
"""Episodes written into one graph; then a new one is made, as the simulated run would grow without end."""

CORPUS = (Path(__file__).parent / "corpus" / "replies.txt").read_text("utf-8").split("\n----\n")
BODIES = [body.encode() for body in (Path(__file__).parent / "corpus" / "bodies.txt").read_text("utf-8").splitlines()]


# -- replies by schema ---------------------------------------------------------------------------------------------


def instance(rng, schema, root=None, depth=0):
    """A value that fits a JSON Schema, as far as the schemas of this package go."""
    root = root or schema
    if "$ref" in schema:
        return instance(rng, root["$defs"][schema["$ref"].rsplit("/", 1)[-1]], root, depth)
    for key in ("anyOf", "oneOf"):
        if key in schema:
            return instance(rng, rng.choice(schema[key]), root, depth)
    if "const" in schema:
        return schema["const"]
    if "enum" in schema:
        return rng.choice(schema["enum"])
    kind = schema.get("type")
    kind = rng.choice(kind) if isinstance(kind, list) else kind
    match kind:
        case "object":
            names = schema.get("properties", {})
            chosen = [n for n in names if n in schema.get("required", ()) or rng.random() < 0.5]
            found = {name: instance(rng, names[name], root, depth + 1) for name in chosen}
            more = schema.get("additionalProperties")
            if isinstance(more, dict) and depth < 5:
                found |= {name: instance(rng, more, root, depth + 1) for name in rng.choice((("t0",), ("t0", "t1")))}
            return found
        case "array":
            least, most = schema.get("minItems", 0), schema.get("maxItems", 4)
            inner = schema.get("items") or {"type": "string"}
            return [instance(rng, inner, root, depth + 1) for _ in range(rng.randint(least, max(least, min(most, 5))))]
        case "integer":
            return rng.choice((rng.randrange(1, 5), rng.randrange(1000), schema.get("minimum", 0)))
        case "number":
            return rng.choice((180.0, rng.uniform(0, 360), rng.randrange(1000)))
        case "boolean":
            return rng.random() < 0.5
        case "null":
            return None
    return _text(rng, schema)


def _text(rng, schema):
    pattern = schema.get("pattern", "")
    if "{6}" in pattern:
        return f"{rng.choice(FRAMES):06d}"
    if pattern.startswith("^-?"):
        return rng.choice(("4", "12.5", "-3", "0"))
    names = ("a", "b", "p1", "p2", "t0", "t1", "o1", "o2")
    words = (*names, *names, "walking", "conversation", "female", "gender", "first to the left", "person", "action")
    return rng.choice((*words, *schema.get("examples", ())))


def written(rng, schema):
    """A model's text: an object by the schema, as it is or with something wrong; or none at all."""
    if schema is None or rng.random() < 0.04:
        return rng.choice(CORPUS)
    value = instance(rng, schema)
    text = json.dumps(value)
    if rng.random() < 0.5:
        data = mutate(rng, text.encode())[0]
        text = data.decode("utf-8", rng.choice(("replace", "surrogateescape")))
    if rng.random() < 0.25:
        shape = rng.choice(
            (
                "```json\n{}\n```",
                "```\n{}```",
                "<think>hm {}</think>{}",
                "<think>{}",
                "hm</think>\n{}",
                "<|channel>thought {} <channel|>{}",
                "Sure: {}",
                "{}{}",
                "\ufeff{}",
                "\u2028 {} \u0000",
            )
        )
        text = shape.replace("{}", text)
    return text


def body_of(rng, text):
    """The body of a completion with this text, as a server sends it, or with something wrong."""
    usage = {"prompt_tokens": 10, "completion_tokens": rng.choice((3, 3, -1, 1.5, None, 2**70, "4"))}
    content = rng.choice(
        (text, text, text, [{"type": "text", "text": text}, "", {"type": "thinking", "thinking": text}])
    )
    message = {"role": "assistant", "content": content} | rng.choice(
        ({}, {}, {}, {"reasoning_content": "hm"}, {"reasoning": text}, {"refusal": rng.choice((None, "no", 3))})
    )
    ended = rng.choice(("stop",) * 9 + ("length", None, "eos", "error", "tool_calls", "\x00", "content_filter"))
    body = {"model": "m", "choices": [{"index": 0, "message": message, "finish_reason": ended}], "usage": usage}
    data = json.dumps(body, ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass")
    kind = rng.random()
    if kind < 0.06:
        data = mutate(rng, data)[0]
    elif kind < 0.08:
        data = mutate(rng, rng.choice(BODIES))[0]
    return data


class Chat(Client):
    """The client of a server whose replies are made by a generator; keeps the bodies."""

    def __init__(self, convention):
        super().__init__(
            "http://127.0.0.1:9/v1", "m", EndpointOptions(retries=1), convention=convention, pause=lambda seconds: None
        )
        self._connections = self
        self.bodies = []
        self.rng = Random(0)
        self._schema = None

    def complete(self, messages, schema=None):
        for message in messages:
            for part in message.parts:
                assert not isinstance(part, str) or part.encode().strip(), "a request holds text that no server takes"
        self._schema = schema
        reply = super().complete(messages, schema)
        thinking_text(reply, self.convention)
        return reply

    def exchange(self, *request, **more):
        """Reply in place of the client's connections."""
        data = body_of(self.rng, written(self.rng, self._schema))
        self.bodies.append(data)
        status = 200 if self.rng.random() < 0.97 else self.rng.choice((204, 400, 401, 404, 429, 500, 503, 529))
        headers = self.rng.choice(
            ({}, {"content-type": "text/html"}, {"retry-after": self.rng.choice(("1", "x", "-1"))})
        )
        return httpx2.Response(status, headers=headers), data


@functools.cache
def _chat(model):
    """One client per model: each opens a connection, which takes longer than a question."""
    return Chat(convention_of(model))


# -- questions -----------------------------------------------------------------------------------------------------


@functools.cache
def _black():
    return np.zeros((480, 480, 3), np.uint8)


def _observe(sequence, frame_index, angle_deg):
    seconds, left = frame_index / 15, int(crop_left(angle_deg))
    return Observation(sequence, frame_index, seconds, angle_deg % 360, FOV_DEG, left, _black())


def _panorama(sequence, frame_index):
    return Panorama(sequence, frame_index, frame_index / 15, b"\xff\xd8 whole \xff\xd9")


def task_of(rng, number, steps, writes):
    """A question of any mode about a sequence that shows nothing."""
    mode = rng.choice(MODES)
    choices = CHOICES if mode == "multiple_choice" else ()
    text = "What does the person who is walking at frame 000015 do at frame 000150?"
    question = Question(f"{number:016x}", "s", text, choices, mode)
    return Task(question, SequenceInfo("s", 15.0, 301, FRAMES), _observe, _panorama, steps.append, writes.append)


class _Worlds:
    """The graph in memory that episodes are written into, made anew after some of them."""

    def __init__(self):
        self._open, self._left = None, 0

    def model(self, number):
        if not self._left:
            if self._open is not None:
                self._open.__exit__(None, None, None)
            self._open, self._left = WorldGraph.memory(), GAMES_PER_WORLD
            self._graph = self._open.__enter__()
        self._left -= 1
        return WorldModel(self._graph, f"run{number}")


_worlds = _Worlds()


def prepare(folder):
    """Make a client per model."""
    for model in MODELS:
        _chat(model)


def run_case(seed, number, folder, save):
    """One question, answered with mutated replies; the number of replies that were read."""
    rng = Random(f"{seed} replies {number}")
    chat = _chat(rng.choice(MODELS))
    chat.rng, chat.bodies = rng, []
    name = rng.choice(METHODS)
    world = _worlds.model(number) if name in WORLD_METHODS else None
    history = rng.choice((None, 1, 2)) if name in CHATS else None
    advice, prompts = rng.choice(("on", "off")), rng.choice(get_args(PromptSet))
    options = MethodOptions(advice=advice, history=history, prompts=prompts)
    method = make_method(name, chat, chat.convention, world, options)
    steps, writes = [], []
    limits.begin()
    try:
        check_prediction(method.answer(task_of(rng, number, steps, writes)), steps)
    except AvrError as error:
        assert str(error) and "\n" not in str(error), error
    except Exception:
        for n, body in enumerate(chat.bodies):
            save(f"reply{n}.json", body)
        raise
    return len(chat.bodies)


def check_prediction(prediction, steps):
    """A prediction has what its status promises, its numbers are finite, and its transcript can be stored."""
    assert isinstance(prediction, Prediction) and prediction.status in ("answered", "invalid"), prediction
    missing = prediction.answer is None or prediction.evidence is None
    assert prediction.status == "answered" or (missing and prediction.reason), prediction
    assert prediction.evidence is None or all(map(math.isfinite, prediction.evidence.box)), prediction
    assert prediction.evidence is None or prediction.evidence.frame in FRAMES, prediction
    for step in steps:
        json.loads(step.request.encode()), json.loads(step.response.encode())
