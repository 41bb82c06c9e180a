"""Estimate the calls, pictures, tokens, hours and cost of a run before anything is sent.

Methods with fixed stages send a fixed number of pictures. Texts and all other methods are estimated by `usage.toml`, a
synthetic measurement. Every total has three values: the expected value, a lower bound and an upper bound. The bounds of
fixed stages are a run without retries and a run that uses all retries. All other bounds are measured quantiles.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import Final

import numpy as np
import numpy.typing as npt

from jrdb_avr.agent.methods.requests import uniform_frames
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.engine.run.bench import find_images, with_grey_pictures
from jrdb_avr.engine.run.endpoint import declared
from jrdb_avr.engine.run.options import EvaluateOptions
from jrdb_avr.engine.run.selection import select_questions
from jrdb_avr.queries.questions import read_question_rows, read_sequences
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH

Total = npt.NDArray[np.float64]

USAGE: Final[Mapping[str, Mapping[str, list[float]]]] = tomllib.loads(
    files(__package__).joinpath("usage.toml").read_text("utf-8")
)
"""Measured usage per question by method and quantity: the mean, a low quantile and a high quantile."""

_FIXED: Final = {
    "monolithic": ((1, 2), (1, 2), (0, 0), (0, 0)),
    "chain-of-thought": ((2, 4), (2, 4), (0, 0), (0, 0)),
    "search-recognize": ((3, 6), (1, 4), (1, 0), (2, 4)),
}
"""For methods with fixed stages, counts without retries and with all retries: calls, times that all panoramas are sent,
further panoramas, and crops."""


def estimate(store: Store, method: str, model: str, options: EvaluateOptions) -> tuple[int, dict[str, Total]]:
    """Estimate the run that `evaluate` would make from nothing with these arguments.

    Args:
        store: The store of the run.
        method: A name of `METHODS`.
        model: The id of the model. Tokens are estimated only for families with a declared rule of resizing.
        options: The options of `evaluate`. Hours need a rate, and dollars need the price.

    Returns:
        The number of questions, and the totals by name, without the requests of the preflight. A total is missing if
        it is unknown.

    Raises:
        InputError: If the usage of the method is unknown, or if the selection names a question, family, template or
            sequence that the store lacks.
        StoreError: If no question is selected, or if no selected question has panoramas.
    """
    if method not in USAGE:
        raise InputError(f"--plan knows the calls of {', '.join(USAGE)}, not of {method}", field="method")
    simulated = declared(model, options.endpoint).simulated
    with with_grey_pictures(store, find_images(store, options.run.images), simulated) as image_root:
        questions = select_questions(read_question_rows(store), options.selection, image_root)
    frames = {name: len(uniform_frames(info.frames)) for name, info in read_sequences(store).items()}
    totals = question_usage(method, [frames[question.sequence] for question in questions])
    totals["pictures"] = totals["panoramas"] + totals["crops"]
    if (tokens := prompt_tokens(totals, model)) is not None:
        totals["prompt_tokens"] = tokens
    return len(questions), totals | _costs(totals, options.endpoint)


def question_usage(method: str, panoramas: list[int]) -> dict[str, Total]:
    """Return what a method sends and reads for some questions.

    Args:
        method: A name of `METHODS`.
        panoramas: For each question, the number of panoramas of a method that cannot look.

    Returns:
        The totals `calls`, `panoramas`, `crops`, `text_tokens` and `reply_tokens`.
    """
    count = len(panoramas)
    totals = {name: np.array(values) * count for name, values in USAGE[method].items()}
    if method in _FIXED:
        calls, sets, further, crops = (np.array((least, least, most)) for least, most in _FIXED[method])
        retried = calls / calls[0]
        totals = {name: total * retried for name, total in totals.items()}
        totals |= {"calls": calls * count, "panoramas": sets * sum(panoramas) + further * count, "crops": crops * count}
    return totals


def prompt_tokens(totals: Mapping[str, Total], model: str) -> Total | None:
    """Return the prompt tokens of calls.

    Args:
        totals: The totals of `question_usage`.
        model: The id of the model.

    Returns:
        The tokens of all pictures and texts, None if the model's rule of resizing is not declared.
    """
    convention = convention_of(model)
    panorama, crop = convention.picture_tokens(WIDTH, HEIGHT), convention.picture_tokens(CROP, CROP)
    if panorama is None or crop is None:
        return None
    return totals["panoramas"] * panorama + totals["crops"] * crop + totals["text_tokens"]


def _costs(totals: Mapping[str, Total], endpoint: EndpointOptions) -> dict[str, Total]:
    """Return the hours and the dollars, if the rate and the price are given."""
    costs = {}
    if "prompt_tokens" in totals:
        prompt, reply = totals["prompt_tokens"], totals["reply_tokens"]
        if endpoint.tpm is not None:
            costs["hours"] = (prompt + reply) / endpoint.tpm / 60
        if endpoint.price is not None:
            costs["dollars"] = (prompt * endpoint.price.input + reply * endpoint.price.output) / 1e6
    if endpoint.rpm is not None:
        costs["hours"] = np.maximum(costs.get("hours", 0.0), totals["calls"] / endpoint.rpm / 60)
    return costs
