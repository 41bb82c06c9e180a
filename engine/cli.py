"""The command `jrdb-avr`.

The module of a command in `engine/commands/` is imported only when the command runs, so that `--help` is fast. An
AvrError is printed as one line on stderr, and the exit code is 1. The exit code of a wrong call is 2.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import resource
import signal
import sys
from pathlib import Path
from typing import Final

import click

from jrdb_avr import __version__
from jrdb_avr.schema.errors import AvrError, did_you_mean

COMMANDS: Final[dict[str, str]] = {
    "sample": "Write synthetic data in the layout of JRDB.",
    "load": "Load a copy of JRDB into a store.",
    "generate": "Find and prove the questions of a store.",
    "import-questions": "Import questions of another program.",
    "rules": "List the rules of the benchmark.",
    "validate": "Check the questions, and derive their answers again.",
    "stats": "Count questions, and score guessers that see no image.",
    "cypher": "Query the graph with Cypher.",
    "sql": "Query the tables with SQL.",
    "schema": "Print the tables of the graph and of the store.",
    "observe": "Write a crop of a panorama as PNG.",
    "preflight": "Check a model's server before a run.",
    "calibrate": "Find out how a model writes the coordinates of a box.",
    "evaluate": "Let a method answer the questions.",
    "mcp": "Serve the questions to an MCP agent.",
    "play": "Let a person answer the questions in the browser.",
    "runs": "List, show, compare, merge or remove runs.",
    "score": "Score the predictions of runs.",
    "report": "Compare the scores of runs in tables.",
    "trace": "Write a page with the steps of a run for a question.",
    "view": "Show runs and questions in the browser.",
    "export": "Write questions or predictions for other tools.",
    "submit": "Write a run as a bundle that can be scored.",
    "inspect": "Write a page to review questions.",
    "demo": "Run every step once on synthetic data.",
}
"""Short help text by command. `--help` reads it here, so that it imports no module of a command."""


_MODULES: Final = {"cypher": "query", "sql": "query", "stats": "generate", "score": "report", "submit": "export"}
"""Name of the module by command, for commands in a module with another name."""


class NamingGroup(click.Group):
    """A group of commands that suggests the nearest name if a command is unknown."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the name of a command, the command, and its arguments. Raise UsageError if the name is unknown."""
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            raise click.UsageError(f"no command {args[0]!r}{did_you_mean(args[0], self.list_commands(ctx))}", ctx)
        return super().resolve_command(ctx, args)


class LazyGroup(NamingGroup):
    """A group of commands that imports the module of a command when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command and return it. Return None if the name is unknown."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(
            f"jrdb_avr.engine.commands.{_MODULES.get(cmd_name, cmd_name.replace('-', '_'))}"
        )
        command: click.Command = getattr(module, cmd_name, None) or module.command
        # Click joins the lines of a paragraph that does not begin with a backspace. Examples must keep their lines.
        command.help = re.sub(r"\n\n(?=Examples?:\n|  )", "\n\n\b\n", inspect.cleandoc(command.help or ""))
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands with their short help texts, without importing modules."""
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
    """Benchmark of active visual reasoning on JRDB: questions with proofs, methods that look and answer, and scores.

    Without a command, print the stores in the working directory, and the next commands to type for each store.
    """
    if ctx.invoked_subcommand is None:
        steps = importlib.import_module("jrdb_avr.engine.commands._next").next_steps(Path.cwd())
        click.echo("\n".join([*steps, "All commands: jrdb-avr --help"]))


def main() -> None:
    """Run the command line. The process ends with the exit code of the command."""
    # If a file exceeds the size limit, the process must report an error instead of being killed by the signal.
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    # A scheduler's stop must leave what Ctrl-C leaves.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
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

        # The text may come from a server or a file, so `note` removes its control characters.
        note(f"jrdb-avr: {' '.join(str(error).split())}")
        sys.exit(1)
    except BrokenPipeError:
        # The reader of the output (such as head) has ended. Python must print nothing more, not even when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except UnicodeEncodeError as error:
        # A file name that is not UTF-8 contains surrogate characters, which cannot be written.
        sys.exit(f"jrdb-avr: {ascii(error.object)[:200]} is not Unicode text: use other names")
    except (MemoryError, ImportError) as error:
        # A library that does not fit into the address space cannot be imported.
        if isinstance(error, ImportError) and resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY:
            raise
        sys.exit("jrdb-avr: the memory does not suffice: raise its limit (ulimit -v), or free some memory")
    except OSError as error:
        click.echo(f"jrdb-avr: {error.strerror or error}: {error.filename or ''}", err=True)
        sys.exit(1)
