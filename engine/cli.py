"""The command `jrdb-avr`.

Commands live in `engine/commands/` and are imported only when they run, so that `--help` answers at once. Errors of
this package become one line on stderr and exit code 1; a wrong call is exit code 2.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import signal
import sys
from pathlib import Path
from typing import Final

import click

from jrdb_avr import __version__
from jrdb_avr.schema.errors import AvrError, did_you_mean

COMMANDS: Final[dict[str, str]] = {
    "sample": "Write a synthetic JRDB root with panoramas.",
    "load": "Read annotations into a store and build its graph.",
    "generate": "Find questions, prove them and write the benchmark.",
    "rules": "List the thresholds of the benchmark.",
    "validate": "Check the question files against the annotations.",
    "stats": "Count questions; show what a blind guesser scores.",
    "cypher": "Query the scene graph.",
    "sql": "Query the Parquet tables.",
    "schema": "Print the tables of graph and store, or draw them.",
    "observe": "Write a crop of a panorama as PNG.",
    "preflight": "Check a model's server before a run.",
    "calibrate": "Find out how a model writes boxes.",
    "evaluate": "Run a method on the questions.",
    "mcp": "Serve the questions to an MCP agent.",
    "play": "Let a person answer the questions in the browser.",
    "world": "Add world models of runs to the graph, or drop them.",
    "runs": "List, show, compare or remove runs.",
    "score": "Score the predictions of runs.",
    "report": "Compare runs in a table.",
    "trace": "Write a page of a run's steps for one question.",
    "view": "Show questions and runs in the browser.",
    "export": "Write predictions in the forms of other tools.",
    "submit": "Write a run as a bundle that others can score.",
    "inspect": "Write a page on which a person reviews questions.",
    "demo": "Run everything once on a synthetic world.",
}
"""Short help by command. It is kept here because `--help` must not import the modules of the commands."""


_MODULES: Final = {"cypher": "query", "sql": "query", "stats": "generate", "score": "report", "submit": "export"}
"""Module by command, for modules that define several commands."""


class NamingGroup(click.Group):
    """A group that suggests the nearest name for an unknown command."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, command and remaining arguments. Raise UsageError with the nearest name for an unknown one."""
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            raise click.UsageError(f"no command {args[0]!r}{did_you_mean(args[0], self.list_commands(ctx))}", ctx)
        return super().resolve_command(ctx, args)


class LazyGroup(NamingGroup):
    """A group that imports the module of a command when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command, or return None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"jrdb_avr.engine.commands.{_MODULES.get(cmd_name, cmd_name)}")
        command: click.Command = getattr(module, cmd_name, None) or module.command
        # Click wraps a paragraph of help unless it begins with a backspace character.
        command.help = re.sub(r"\n\n(?=Examples?:\n|  )", "\n\n\b\n", inspect.cleandoc(command.help or ""))
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__)
@click.pass_context
def group(ctx: click.Context) -> None:
    """Active visual reasoning over JRDB: questions with proofs, observations, methods, scores.

    Without a command, print the stores of the working directory and the next steps for each.
    """
    if ctx.invoked_subcommand is None:
        steps = importlib.import_module("jrdb_avr.engine.commands._next").next_steps(Path.cwd())
        click.echo("\n".join([*steps, "All commands: jrdb-avr --help"]))


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
