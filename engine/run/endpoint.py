"""Connect to the server of a model: check it before a run, start the simulated model, and store calibrations.

STORE/conventions/<model>.json    the calibration of a model: how it writes boxes, and how its errors repeat
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.calibrate import Calibration
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.options import DEFAULTS, EndpointOptions
from jrdb_avr.agent.preflight import CROPS, preflight, require
from jrdb_avr.agent.simulated.profiles import Errors, profile_of
from jrdb_avr.queries.store import Store, is_plain_name, write_json
from jrdb_avr.schema.errors import EndpointError, StoreError
from jrdb_avr.schema.repeats import USUAL_REPEATS


class Endpoint:
    """A model server that has been checked. The checks are called preflight.

    Attributes:
        convention: How the model writes boxes.
        repeats: Weights of repeated readings: the measured ones of the calibration, or the usual ones.
        client: The client that sends requests to the server.
        settings: Settings for the manifest of a run, as plain JSON. A run can be resumed only with equal settings.
        warnings: One line for each check that failed.
        served: The id of the model in the server's first reply.
    """

    def __init__(
        self,
        calibration: Calibration | None,
        model: str,
        base_url: str,
        options: EndpointOptions = DEFAULTS,
        cache: Path | None = None,
        method: str | None = None,
        strict: bool = False,
        crops: int = CROPS,
    ) -> None:
        """Send the requests of the preflight to a server. Compare `options` with the options of the calibration.

        Args:
            calibration: The calibration of the model, or None.
            model: The id of the model.
            base_url: The address of the server.
            options: The options of the requests.
            cache: The file that stores finished calls. If None, calls are not stored.
            method: The name of the method. Only checks that this method needs must pass. If None, all checks must pass.
            strict: Whether to raise an error if a check that must pass fails. Otherwise, `warnings` lists the failure.
            crops: The number of crops that the largest request of the run can have.

        Raises:
            EndpointError: If the server does not reply, if `strict` is true and a check that must pass fails, or if
                the model was calibrated with other options.
        """
        convention = convention_of(model)
        convention = convention if calibration is None else calibration.convention(convention)
        options = declared(model, options)
        self.repeats = USUAL_REPEATS if calibration is None else calibration.repeats
        self.client = Client(base_url, model, options, convention=convention, cache=cache)
        self.convention = self.client.convention
        checks = preflight(self.client, crops)
        failed = [check.line for check in checks if not check.passed]
        self.warnings = require(checks, method) if strict else failed
        self.served = self.client.served[0]
        if calibration is not None:
            current = (options.response_format, options.thinking, self.served)
            before = (calibration.response_format, calibration.thinking, calibration.served_model)
            for what, now, then in zip(("response format", "thinking", "served model"), current, before, strict=True):
                if now != then:
                    raise EndpointError(
                        f"{model} was calibrated with {what} {then!a}, not {now!a}: calibrate again with these "
                        "options, or delete its file in the store's folder conventions"
                    )
        calibrated = {} if calibration is None else {"asked_sha256": calibration.asked_sha256}
        self.settings = {
            "endpoint": self.client.settings(),
            "served_model": self.served,
            "server_version": self.client.server_version(),
            "convention": self.convention.settings() | calibrated,
            "repeats": msgspec.structs.asdict(self.repeats),
            "decoder": decode.VERSION,
            "preflight": self.warnings,
        }

    def changed(self) -> list[str]:
        """Return a warning if a later reply named another model than the first, and one if tokens are estimates."""
        lines = []
        if others := ", ".join(ascii(name) for name in self.client.served if name != self.served):
            lines.append(f"the server changed its model during the run: {self.served!a}, then {others}")
        if replies := self.client.estimates:
            lines.append(f"the server counted no tokens in {replies} replies: tokens and costs are estimates")
        return lines


def declared(model: str, options: EndpointOptions) -> EndpointOptions:
    """Return the options, declared simulated if the name of the model says so."""
    return options if profile_of(model) is None else replace(options, simulated=True)


@contextlib.contextmanager
def serving(
    model: str, base_url: str | None, store: Store | None = None, errors: Errors | None = None
) -> Iterator[str]:
    """Yield the address of a model's server. A server that this function starts is stopped after the `with` block.

    Args:
        model: The id of the model.
        base_url: The address of a running server. None starts the server of the simulated model.
        store: The store with the annotations that the simulated model reads. Without it, the model passes only checks.
        errors: The errors of the simulated model. None takes the profile that `model` names.

    Yields:
        The address.

    Raises:
        EndpointError: If `base_url` is None and the model is not the simulated model.
        StoreError: If the store has no annotations for the simulated model.
    """
    if base_url is not None:
        yield base_url
    elif profile_of(model) is not None:
        from jrdb_avr.agent.simulated.server import simulated_server
        from jrdb_avr.agent.simulated.sight import Sight

        with simulated_server(None if store is None else Sight(store), errors) as url:
            yield url
    else:
        raise EndpointError(f"--model {model} needs --base-url, the address of the server that has it")


# -- calibrations in a store ------------------------------------------------------------------------------------------


def convention_path(store: Store, model: str) -> Path:
    """Return the path of the calibration file of a model.

    The name of the file is the id of the model. If the id cannot be a file name, the name of the file consists of a
    shortened id and a hash.
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", model).strip("-.")[:80]
    if plain != model or not is_plain_name(plain):
        plain = f"{plain or 'model'}-{hashlib.sha256(model.encode()).hexdigest()[:8]}".replace("..", "-")
    return store.path / "conventions" / f"{plain}.json"


def read_calibration(store: Store, model: str) -> Calibration | None:
    """Read the stored calibration of a model.

    Args:
        store: The store.
        model: The id of the model.

    Returns:
        The calibration, or None if the store has no calibration of this model.

    Raises:
        StoreError: If the file cannot be read, or if it is the calibration of another model.
    """
    path = convention_path(store, model)
    try:
        calibration = msgspec.json.decode(path.read_bytes(), type=Calibration)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise StoreError(f"cannot read {path}: {error}; calibrate again, or delete it") from None
    if calibration.model != model:
        raise StoreError(f"{path} is of another model, {calibration.model!a}: calibrate again, or delete it")
    return calibration


def write_calibration(store: Store, calibration: Calibration) -> Path:
    """Write a calibration atomically, and return the path of the file."""
    path = convention_path(store, calibration.model)
    write_json(path, calibration)
    return path
