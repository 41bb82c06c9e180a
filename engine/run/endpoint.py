"""A model's server, found to be there and to keep to what is declared of it, before anything is asked of it.

STORE/conventions/<model>.json    how the model writes boxes, as `calibrate` found it
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.calibrate import Calibration
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import Convention, convention_of
from jrdb_avr.agent.model.options import DEFAULTS, Options
from jrdb_avr.agent.model.preflight import preflight, require
from jrdb_avr.agent.simulated.noise import PERFECT, Knobs
from jrdb_avr.queries.store import Store, is_plain_name, write_json
from jrdb_avr.schema.errors import EndpointError, StoreError

MARKER: Final = "marker"
"""The model that needs no server of its user's: `serving` starts one."""


@dataclass(frozen=True)
class Endpoint:
    """A server that passed its preflight. `warnings`: lines on what is wrong with it, but no reason not to ask it.

    `settings` is what a run's manifest says of it, as plain JSON: a run that is resumed needs one equal in all but
    address, timeout and retries.
    """

    client: Client
    convention: Convention
    served: str
    settings: dict[str, Any]
    warnings: tuple[str, ...]

    def changed(self) -> str:
        """One line if replies named other models than the first one; empty if not."""
        others = ", ".join(ascii(name) for name in self.client.served if name != self.served)
        return f"the server changed its model while it was asked: {self.served!a}, then {others}" if others else ""


def connect(
    store: Store | None,
    model: str,
    base_url: str,
    options: Options = DEFAULTS,
    cache: Path | None = None,
    method: str | None = None,
) -> Endpoint:
    """Check a server and say how it is to be asked; `cache` is the file for finished calls, and `method` the one that
    is to ask it (None: any): what it does not need may be lacking.

    The convention is the one declared for the model, with what `calibrate` found where the store holds that. Raises
    EndpointError in one line where a check fails, or where the store's calibration is of another way of asking.
    """
    declared = convention_of(model)
    found = None if store is None else read_calibration(store, model)
    convention = declared if found is None else found.convention(declared)
    client = Client(base_url, model, options, convention=convention, cache=cache)
    warnings = require(preflight(client), method)
    served = client.served[0]
    if store is not None and found is not None:
        asked = (options.response_format, options.thinking, served)
        before = (found.response_format, found.thinking, found.served_model)
        for what, now, then in zip(("response format", "thinking", "served model"), asked, before, strict=True):
            if now != then:
                raise EndpointError(
                    f"{model} was calibrated with {what} {then!a}, not {now!a}: calibrate again with these options, "
                    f"or delete {convention_path(store, model)}"
                )
    convention_settings = convention.settings() | ({} if found is None else {"asked_sha256": found.asked_sha256})
    settings = {
        "endpoint": client.settings(),
        "served_model": served,
        "server_version": client.server_version(),
        "convention": convention_settings,
        "decoder": decode.VERSION,
    }
    return Endpoint(client, convention, served, settings, tuple(warnings))


@contextlib.contextmanager
def serving(model: str, base_url: str | None, log: Path | None = None, knobs: Knobs = PERFECT) -> Iterator[str]:
    """The address of the model's server: the one given, or that of a marker server started for this block.

    `log` and `knobs` are the marker server's. Raises EndpointError where there is neither.
    """
    from jrdb_avr.agent.simulated.child import marker_server

    if base_url is not None:
        yield base_url
    elif model == MARKER:
        with marker_server(log, knobs) as url:
            yield url
    else:
        raise EndpointError(f"--model {model} needs --base-url, the address of the server that has it")


# -- calibrations in a store ------------------------------------------------------------------------------------------


def convention_path(store: Store, model: str) -> Path:
    """Where a model's calibration lies; a name that no file can have is made plain and told apart by its hash."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", model).strip("-.")[:80]
    if plain != model or not is_plain_name(plain):
        plain = f"{plain or 'model'}-{hashlib.sha256(model.encode()).hexdigest()[:8]}".replace("..", "-")
    return store.path / "conventions" / f"{plain}.json"


def read_calibration(store: Store, model: str) -> Calibration | None:
    """The store's calibration of a model; None where there is none. Raises StoreError for one that cannot be read."""
    path = convention_path(store, model)
    try:
        found = msgspec.json.decode(path.read_bytes(), type=Calibration)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise StoreError(f"cannot read {path}: {error}; calibrate again, or delete it") from None
    if found.model != model:
        raise StoreError(f"{path} is of another model, {found.model!a}: calibrate again, or delete it")
    return found


def write_calibration(store: Store, calibration: Calibration) -> Path:
    """Write a calibration in which a reading was chosen, atomically; returns where."""
    path = convention_path(store, calibration.model)
    write_json(path, calibration)
    return path
