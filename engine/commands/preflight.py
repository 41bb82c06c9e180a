"""`jrdb-avr preflight`: can this server be asked at all?"""

from __future__ import annotations

import sys

import click

from jrdb_avr.agent.model.options import Options
from jrdb_avr.engine.commands._endpoint import endpoint_options, need_address
from jrdb_avr.engine.console import json_option, note, print_json, print_rows


@click.command(
    epilog="Example: jrdb-avr preflight --model Qwen/Qwen3-VL-8B-Instruct --base-url http://localhost:8000/v1"
)
@click.option("--model", required=True, help="Model id to ask for; 'marker' is the built-in reader of marks.")
@click.option("--base-url", help="An OpenAI-compatible server, as http://localhost:8000/v1.")
@endpoint_options
@json_option
def command(model: str, base_url: str | None, options: Options, as_json: bool) -> None:
    """Check a model's server: text, JSON schema, pictures, thinking, and what its replies say of themselves.

    'evaluate' makes the same checks before a run. Exit code 1 where one fails that a run needs.
    """
    from jrdb_avr.agent.model.client import Client
    from jrdb_avr.agent.model.conventions import convention_of
    from jrdb_avr.agent.model.preflight import preflight, require
    from jrdb_avr.engine.run.endpoint import serving
    from jrdb_avr.schema.errors import EndpointError

    need_address(model, base_url)
    with serving(model, base_url) as url:
        checks = preflight(Client(url, model, options, convention=convention_of(model)))
    if as_json:
        print_json(
            [
                {
                    "check": check.name,
                    "passed": check.passed,
                    "needed": check.needed,
                    "seen": check.seen,
                    "remedy": "" if check.passed else check.remedy,
                }
                for check in checks
            ]
        )
    else:
        print_rows(
            [
                {
                    "check": check.name,
                    "result": "passed" if check.passed else "failed" if check.needed else "warning",
                    "seen": check.seen,
                    "what to do": "" if check.passed else check.remedy,
                }
                for check in checks
            ],
            title=f"Preflight of {model}",
        )
    try:
        require(checks)
    except EndpointError as error:
        note(f"jrdb-avr: {error}")
        sys.exit(1)
