"""Connect to the server of a model: checks before a run, the server of the built-in model, and stored calibrations.

STORE/conventions/<model>.json    how the model writes boxes, found by `calibrate`
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

import msgspec

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.calibrate import Calibration
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.options import DEFAULTS, EndpointOptions
from jrdb_avr.agent.preflight import preflight, require
from jrdb_avr.agent.simulated.knobs import Knobs, profile_of
from jrdb_avr.queries.store import Store, is_plain_name, write_json
from jrdb_avr.schema.errors import EndpointError, StoreError


class Endpoint:
    """A server after its preflight.

    Attributes:
        settings: Plain JSON for the manifest of a run; a resumed run needs equal settings (`run.check_manifest`).
        warnings: A line per failed check.
        served: The id of the model in the replies of the server.
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
    ) -> None:
        """Check a server.

        Args:
            calibration: The calibration of the model, if any.
            model: The id of the model.
            base_url: The address of the server.
            options: The options of its requests.
            cache: The file of finished calls.
            method: The player; its run needs only some of the checks. None needs all.
            strict: Whether to refuse a run if a check fails that its method needs.

        Raises:
            EndpointError: The server does not reply, a needed check fails, or the calibration has other options.
        """
        declared = convention_of(model)
        self.convention = declared if calibration is None else calibration.convention(declared)
        self.client = Client(base_url, model, options, convention=self.convention, cache=cache)
        checks = preflight(self.client)
        if strict:
            require(checks, method)
        self.warnings = [check.line for check in checks if not check.passed]
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
            "decoder": decode.VERSION,
            "preflight": self.warnings,
        }

    def changed(self) -> str:
        """Return a line about replies that named another model than the first reply; "" if none did."""
        others = ", ".join(ascii(name) for name in self.client.served if name != self.served)
        return f"the server changed its model during the run: {self.served!a}, then {others}" if others else ""


@contextlib.contextmanager
def serving(model: str, base_url: str | None, log: Path | None = None, knobs: Knobs | None = None) -> Iterator[str]:
    """Yield the address of the server of a model.

    Args:
        model: The id of the model.
        base_url: The address; without one, the block has a server of the simulated model.
        log: The log file of the simulated model.
        knobs: Knobs in place of the profile of the simulated model.

    Yields:
        The address.

    Raises:
        EndpointError: The model is not the simulated one and has no address.
    """
    from jrdb_avr.agent.simulated.server import marker_server

    if base_url is not None:
        yield base_url
    elif (profile := profile_of(model)) is not None:
        with marker_server(log, knobs or profile) as url:
            yield url
    else:
        raise EndpointError(f"--model {model} needs --base-url, the address of the server that has it")


# -- calibrations in a store ------------------------------------------------------------------------------------------


def convention_path(store: Store, model: str) -> Path:
    """Return the file of the calibration of a model. A name that no file can have is shortened and gets a hash."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", model).strip("-.")[:80]
    if plain != model or not is_plain_name(plain):
        plain = f"{plain or 'model'}-{hashlib.sha256(model.encode()).hexdigest()[:8]}".replace("..", "-")
    return store.path / "conventions" / f"{plain}.json"


def read_calibration(store: Store, model: str) -> Calibration | None:
    """Read the calibration of a model.

    Args:
        store: The store.
        model: The id of the model.

    Returns:
        The calibration; None if the store has none.

    Raises:
        StoreError: The file cannot be read, or belongs to another model.
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
    """Write a calibration atomically, and return its file."""
    path = convention_path(store, calibration.model)
    write_json(path, calibration)
    return path
