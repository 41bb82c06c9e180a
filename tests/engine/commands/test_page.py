"""The documentation of the commands is what they say of themselves, and names no option that there is not."""

import re
import subprocess
import sys

import pytest
from environment import DOCS

from jrdb_avr.engine.cli import COMMANDS

PAGE = (DOCS / "commands.md").read_text("utf-8")
HELPS = {
    path: set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", text))
    for path, text in re.findall(r"^#+ `jrdb-avr ([a-z -]+)`\n\n```text\n(.*?)\n```", PAGE, flags=re.M | re.S)
}


def test_the_page_is_what_the_commands_say():
    # In a process of its own: a command keeps the help option that it was first asked with, here by any other test.
    command = "-m jrdb_avr.engine.commands.page commands"
    made = subprocess.run([sys.executable, *command.split()], capture_output=True, check=True, encoding="utf-8")
    assert made.stdout == PAGE, f"python {command} > docs/commands.md"


def test_every_command_is_on_the_page_with_an_example():
    assert set(COMMANDS) <= HELPS.keys()
    sections = re.findall(r"^## `jrdb-avr ([a-z-]+)`\n(.*?)(?=^## |\Z)", PAGE, flags=re.M | re.S)
    assert {name for name, _ in sections} == set(COMMANDS)
    for name, text in sections:
        assert f"jrdb-avr {name} " in text.split("Examples:")[-1].split("Example:")[-1], name


@pytest.mark.parametrize("path", sorted([*DOCS.glob("*.md"), DOCS.parent / "README.md"]), ids=lambda path: path.name)
def test_docs_name_only_options_that_there_are(path):
    for block in re.findall(r"```(?:console|sh|bash)\n(.*?)```", path.read_text("utf-8"), flags=re.S):
        for line in re.split(r"\n|&&|;|\|", block.replace("\\\n", " ")):
            called = re.search(r"jrdb-avr ([\w-]+(?: (?:merge|drop))?)(.*)", line.split(" #")[0])
            if called is None:
                continue
            name = called[1] if called[1] in HELPS else called[1].split()[0]
            assert name in HELPS, line
            given = set(re.findall(r"(?<=\s)--[a-z][a-z-]*", called[2]))
            assert given <= HELPS[name] | {"--help"}, line
