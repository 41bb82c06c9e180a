"""Who may import whom: the folders keep apart, and the command line starts light."""

import ast
import subprocess
import sys

import pytest
from sources import FOLDERS, ROOT, imports, paths

MAY_IMPORT = {
    "schema": {"schema"},
    "queries": {"schema", "queries"},
    "loaders": {"schema", "queries", "loaders"},
    "agent": {"schema", "queries", "agent"},
    "engine": {"schema", "queries", "loaders", "engine"},
}
# The run and command-line edge: only here a method is picked and handed its questions.
AGENT_USERS = ("engine/run/", "engine/integrations/", "engine/commands/")


def imported(path):
    """Full names imported anywhere in a module, relative ones resolved."""
    package = ["jrdb_avr", *path.relative_to(ROOT).parts[:-1]]
    for node in imports(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        else:
            base = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join([*base, *([node.module] if node.module else [])])
            yield name
            # `from jrdb_avr import schema` names a folder in its list.
            yield from (f"{name}.{alias.name}" for alias in node.names if name == "jrdb_avr")


@pytest.mark.parametrize("folder", FOLDERS)
def test_folders_keep_apart(folder):
    checked = 0
    for path in paths():
        name = str(path.relative_to(ROOT))
        if not name.startswith(f"{folder}/"):
            continue
        allowed = MAY_IMPORT[folder] | ({"agent"} if name.startswith(AGENT_USERS) else set())
        parts = [part.split(".") for part in imported(path)]
        used = {part[1] for part in parts if part[0] == "jrdb_avr" and len(part) > 1 and part[1] in FOLDERS}
        assert used <= allowed, name
        assert not {part[0] for part in parts} & set(FOLDERS), f"{name}: the folders import as jrdb_avr.<folder>"
        checked += 1
    assert checked


def test_only_what_pyproject_names_is_imported():
    declared = {
        "kuzu",
        "duckdb",
        "pyarrow",
        "cv2",
        "numpy",
        "click",
        "rich",
        "msgspec",
        "httpx2",
        "yaml",
        "tenacity",
        "tabulate",
    }
    declared |= {"jrdb_avr", "jinja2", "sklearn"}
    # Of the extras, in `engine/integrations/` alone; pydantic, uvicorn and anyio come with mcp.
    declared |= {"inspect_ai", "mcp", "gymnasium", "pydantic", "uvicorn", "anyio", "PIL"}
    # IPython runs a notebook, and is imported inside functions alone.
    declared |= {"IPython"}
    # An extra, in `queries/workers.py` alone, inside a function.
    declared |= {"ray"}
    # markupsafe comes with jinja2, threadpoolctl with scikit-learn.
    used = {name.split(".")[0] for path in paths() for name in imported(path)}
    assert used - set(sys.stdlib_module_names) <= declared | {"markupsafe", "threadpoolctl"}


def test_the_agents_edge_never_opens_the_private_tables():
    for path in (ROOT / "agent").rglob("*.py"):
        text = path.read_text("utf-8")
        for private in (
            "opaque.key",
            "answers.parquet",
            "evidence.parquet",
            'questions("answers")',
            'questions("evidence")',
        ):
            assert private not in text, path


EXTRAS = ("inspect_ai", "mcp", "gymnasium", "pydantic", "uvicorn", "ray", "trl", "PIL")
HEAVY = (*EXTRAS, "kuzu", "duckdb", "pyarrow", "cv2", "numpy", "httpx2", "rich", "msgspec", "jinja2", "sklearn")


def loaded_after(code):
    check = f"{code}\nimport sys\nprint(' '.join(name for name in {HEAVY!r} if name in sys.modules))"
    return set(subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True).stdout.split())


def test_the_command_line_starts_light():
    assert not loaded_after("import jrdb_avr.engine.cli")


def test_no_public_name_needs_an_extra():
    """Also where the extras are installed, importing the whole library loads none of them."""
    assert not loaded_after("import jrdb_avr\n[getattr(jrdb_avr, name) for name in jrdb_avr.__all__]") & set(EXTRAS)


def test_engines_are_imported_where_they_are_used():
    modules = ("queries.store", "queries.graph.guard", "queries.sql", "queries.graph.handle", "engine.observe.observer")
    loaded = loaded_after("\n".join(f"import jrdb_avr.{module}" for module in modules))
    assert not loaded & {"kuzu", "duckdb", "cv2", "httpx2", "rich"}
