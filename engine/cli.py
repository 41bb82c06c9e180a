"""The command `jrdb-avr`.

Commands live in `engine/commands/` and are imported only when they run, so that `--help` answers at once. Errors of
this package become one line on stderr and exit code 1; a wrong call is exit code 2.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from typing import Final

import click

from jrdb_avr import __version__
from jrdb_avr.schema.errors import AvrError

COMMANDS: Final[dict[str, str]] = {
    "sample": "Write a synthetic JRDB root with panoramas.",
    "load": "Read annotations into a store and build its graph.",
    "generate": "Find questions, prove them and write the benchmark.",
    "validate": "Check the question files against the annotations.",
    "stats": "Count questions; show what a blind guesser scores.",
    "cypher": "Ask the scene graph.",
    "sql": "Ask the Parquet tables.",
    "observe": "Look: write a crop of a panorama as PNG.",
    "preflight": "Check a model's server before a run.",
    "calibrate": "Find out how a model writes boxes.",
    "evaluate": "Run a method on the questions.",
    "mcp": "Let an agent that speaks MCP answer the questions.",
    "world": "Bring runs' world models into the graph, or drop them.",
    "score": "Score the predictions of runs.",
    "report": "Compare runs in a table.",
    "trace": "Show what a run did with a question, step by step.",
    "export": "Write predictions in the forms of other tools.",
    "submit": "Write a run as a bundle, to be scored elsewhere.",
    "inspect": "Show questions on a page, for a person to judge.",
    "demo": "Run everything once on a synthetic world.",
}
"""Every command with its short help, which must not need the command's module."""


_MODULES: Final = {"cypher": "query", "sql": "query", "stats": "generate", "score": "report", "submit": "export"}
"""The modules of commands that share one; each command there has its own name."""


class LazyGroup(click.Group):
    """A group whose commands are imported when called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"jrdb_avr.engine.commands.{_MODULES.get(cmd_name, cmd_name)}")
        command: click.Command = getattr(module, cmd_name, None) or module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__)
def group() -> None:
    """Active visual reasoning over JRDB: questions with proofs, observations, methods, scores."""


def main() -> None:
    """Entry point of the command line."""
    # A write past a file-size limit must be an error that is reported, not a signal that kills.
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        group(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("stopped", err=True)
        sys.exit(130)
    except AvrError as error:
        from jrdb_avr.engine.console import note

        # The text may come from a server or a file: `note` removes control characters.
        note(f"jrdb-avr: {' '.join(str(error).split())}")
        sys.exit(1)
    except BrokenPipeError:
        # The reader of the output (head, less) has gone: print nothing more, not even at shutdown.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except UnicodeEncodeError as error:
        # A lone surrogate, usually from a non-UTF-8 file name; no table can hold it.
        click.echo(f"jrdb-avr: {ascii(error.object)[:200]} is no Unicode text: use other names", err=True)
        sys.exit(1)
    except OSError as error:
        click.echo(f"jrdb-avr: {error.strerror or error}: {error.filename or ''}", err=True)
        sys.exit(1)
