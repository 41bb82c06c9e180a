"""`jrdb-avr preflight`: check a model's server before a run."""

from __future__ import annotations

import sys
from typing import Any

import click

from jrdb_avr.engine.commands._declared import endpoint_options
from jrdb_avr.engine.commands._options import form_option
from jrdb_avr.engine.console import RowFormat, note, print_rows


@click.command()
@endpoint_options
@form_option
def command(model: str, endpoint: Any, form: RowFormat) -> None:
    """Check what a model's server supports: JSON replies, pictures, system message, thinking, and the largest requests.

    The result of a check is 'passed', 'failed', or 'warning'. A check that did not pass has the result 'warning' if no
    method depends on the check. The exit code is 1 if any result is 'failed'. Before a run, 'evaluate' makes the same
    checks. It prints and records a warning for each check that did not pass.

    Example:
      jrdb-avr preflight --model Qwen3-VL-8B --base-url http://localhost:8000/v1
    """
    from jrdb_avr.agent.model.client import Client
    from jrdb_avr.agent.model.conventions import convention_of
    from jrdb_avr.agent.preflight import preflight, require
    from jrdb_avr.engine.run.endpoint import declared, serving
    from jrdb_avr.schema.errors import EndpointError

    with serving(model, endpoint.base_url) as url:
        checks = preflight(Client(url, model, declared(model, endpoint), convention=convention_of(model)))
    rows: list[dict[str, Any]] = []
    for check in checks:
        remedy = "" if check.passed else check.remedy
        if form:
            row = {"passed": check.passed, "needed": check.needed, "seen": check.result, "remedy": remedy}
        else:
            result = "passed" if check.passed else "failed" if check.needed else "warning"
            row = {"result": result, "seen": check.result, "what to do": remedy}
        rows.append({"check": check.name, **row})
    print_rows(rows, title=f"Preflight of {model}", form=form)
    try:
        require(checks)
    except EndpointError as error:
        note(f"jrdb-avr: {error}")
        sys.exit(1)
