"""Who may import whom: the folders keep apart, and the command line starts light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import jrdb_avr

ROOT = Path(jrdb_avr.__file__).parent
FOLDERS = ("schema", "loaders", "queries", "engine", "agent")
MAY_IMPORT = {
    "schema": {"schema"},
    "queries": {"schema", "queries"},
    "loaders": {"schema", "queries", "loaders"},
    "agent": {"schema", "queries", "agent"},
    "engine": {"schema", "queries", "loaders", "engine"},
}
# The run and command-line edge: only here a method is picked and handed its questions.
AGENT_USERS = ("engine/run/", "engine/commands/")


def modules():
    return sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


def imported(path):
    """Full names imported anywhere in a module, relative ones resolved."""
    package = ["jrdb_avr", *path.relative_to(ROOT).parts[:-1]]
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join([*base, *([node.module] if node.module else [])])
            yield name
            # `from jrdb_avr import schema` names a folder in its list.
            yield from (f"{name}.{alias.name}" for alias in node.names if name == "jrdb_avr")


def folders(path):
    parts = [name.split(".") for name in imported(path)]
    return {part[1] for part in parts if part[0] == "jrdb_avr" and len(part) > 1 and part[1] in FOLDERS}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_folders_keep_apart(path):
    name = str(path.relative_to(ROOT))
    allowed = MAY_IMPORT[path.relative_to(ROOT).parts[0]] | ({"agent"} if name.startswith(AGENT_USERS) else set())
    assert folders(path) <= allowed
    bare = {part.split(".")[0] for part in imported(path)}
    assert not bare & set(FOLDERS), "the folders import as jrdb_avr.<folder>"


def test_the_folders_are_all_there():
    assert {path.relative_to(ROOT).parts[0] for path in modules()} == set(FOLDERS)


def test_only_what_pyproject_names_is_imported():
    declared = {"kuzu", "duckdb", "pyarrow", "cv2", "numpy", "click", "rich", "msgspec", "httpx2", "yaml"}
    declared |= {"jrdb_avr", "jinja2"}
    # markupsafe comes with jinja2.
    used = {name.split(".")[0] for path in modules() for name in imported(path)}
    assert used - set(sys.stdlib_module_names) <= declared | {"markupsafe"}


def test_the_agents_edge_never_opens_the_private_tables():
    for path in (ROOT / "agent").rglob("*.py"):
        text = path.read_text("utf-8")
        for private in ("answers.parquet", "evidence.parquet", 'questions("answers")', 'questions("evidence")'):
            assert private not in text, path


HEAVY = ("kuzu", "duckdb", "pyarrow", "cv2", "numpy", "httpx2", "rich", "msgspec", "jinja2")


def loaded_after(code):
    check = f"{code}\nimport sys\nprint(' '.join(name for name in {HEAVY!r} if name in sys.modules))"
    return set(subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True).stdout.split())


def test_the_command_line_starts_light():
    assert not loaded_after("import jrdb_avr.engine.cli")


@pytest.mark.parametrize(
    "module",
    ["queries.store", "queries.graph.guard", "queries.sql", "queries.graph.handle", "engine.observe.observer"],
)
def test_engines_are_imported_where_they_are_used(module):
    assert not loaded_after(f"import jrdb_avr.{module}") & {"kuzu", "duckdb", "cv2", "httpx2", "rich"}
