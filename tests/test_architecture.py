"""The layout that `docs/architecture.md` draws: which room imports which, size of modules, one meaning per name."""

import ast
import re
from collections import defaultdict
from functools import cache
from graphlib import CycleError, TopologicalSorter

import house
import pytest
from sources import ROOT, imports, parsed

PACKAGES = ("schema", "queries", "loaders", "agent", "engine")

# Each room, and the rooms that it may import; its own modules are always allowed.
ENGINE_LEAVES = {"schema", "queries"}
STAGES = ENGINE_LEAVES | {
    "loaders",
    "engine.local_server",
    "engine.text_table",
    "engine.console",
    "engine.observe",
    "engine.rederive",
}
PAGES = STAGES | {"engine.generate", "engine.report"}
AGENT = {"schema", "queries"}
MAY_IMPORT = {
    "schema": set(),
    "queries": {"schema"},
    "loaders": {"schema", "queries"},
    "agent.model": AGENT,
    "agent.perceive": AGENT | {"agent.model", "agent.methods"},
    "agent.look": AGENT | {"agent.perceive"},
    "agent.world": AGENT | {"agent.perceive", "agent.look"},
    "agent.methods": AGENT | {"agent.model"},
    "agent.reference": AGENT | {"agent.model", "agent.perceive", "agent.look", "agent.world", "agent.methods"},
    "agent.simulated": AGENT | {"agent.model", "agent.perceive", "agent.look"},
    "agent.preflight": AGENT | {"agent.model", "agent.methods", "agent.reference"},
    "engine.text_table": set(),
    "engine.local_server": {"schema"},
    "engine.console": {"schema", "engine.text_table"},
    "engine.cli": {"schema", "engine.console"},
    "engine.rederive": {"schema", "queries.store"},
    "engine.observe": ENGINE_LEAVES,
    "engine.generate": STAGES | {"engine.report"},
    "engine.report": STAGES,
    "engine.pages": PAGES,
    "engine.validate": PAGES,
    "engine.run": PAGES | {"agent"},
    "engine.integrations": PAGES | {"engine.pages", "engine.run", "engine.validate", "agent"},
    "engine.commands": PAGES
    | {"engine.cli", "engine.pages", "engine.validate", "engine.run", "engine.integrations", "agent"},
}
LARGEST = 450
"""Maximum number of lines of a module."""
FLOORS = 6
"""Maximum number of floors of `engine/generate`."""
SEARCH, CYPHER = ("search", "generators", "necessity"), 220
"""Folders of the statements that find and prove questions, and the maximum number of their lines."""
READS = re.compile(r"\b(MATCH|UNWIND) ")
REPEATED = {"command", "main", "serve", "load", "generate", "validate", "evaluate", "score", "report", "diff"}
"""Public names that may repeat: click commands, which are named like their functions, and entry points of processes."""


@cache
def modules():
    """{dotted name: path} of every module of the five packages."""
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imported(path):
    """Modules of this project that a module imports anywhere, also for type checking."""
    found = set()
    for node in imports(path):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            if not (node.module or "").startswith("jrdb_avr."):
                continue  # Another project's, or the version of the package itself.
            base = node.module.removeprefix("jrdb_avr.")
            for alias in node.names:
                name = f"{base}.{alias.name}"
                found.add(name if name in modules() else base)
        else:
            names = [alias.name for alias in node.names if alias.name.startswith("jrdb_avr.")]
            found.update(name.removeprefix("jrdb_avr.") for name in names)
    return found


def room(module):
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] in ("agent", "engine") else parts[0]


def test_imports_go_downwards():
    for name, path in modules().items():
        if name in PACKAGES:
            assert not imported(path), name
            continue
        allowed = MAY_IMPORT[room(name)]
        for other in imported(path):
            ancestors = {other[:end] for end, char in enumerate(other + ".") if char == "."}
            assert room(other) == room(name) or ancestors & allowed, f"{name} imports {other}"


def test_no_module_imports_itself_through_others():
    graph = {name: imported(path) - {name} for name, path in modules().items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_modules_are_not_large():
    sizes = {name: len(path.read_text("utf-8").splitlines()) for name, path in modules().items()}
    assert {name: size for name, size in sizes.items() if size > LARGEST} == {}


def test_every_room_keeps_to_its_budget():
    lines = house.rooms()
    assert {room: count for room, count in lines.items() if count > house.BUDGETS.get(room, 0)} == {}
    assert lines.total() <= house.TOTAL
    assert house.lines_of_tests() <= house.TESTS


def test_generation_has_few_floors():
    """A floor is a place in the longest chain of imports inside `engine/generate`."""
    inside = {name: path for name, path in modules().items() if name.startswith("engine.generate.")}
    below = {name: (imported(path) & inside.keys()) - {name} for name, path in inside.items()}
    floors = {}
    for name in TopologicalSorter(below).static_order():
        floors[name] = 1 + max((floors[other] for other in below[name]), default=0)
    assert floors["engine.generate.run"] > 3
    assert {name: floor for name, floor in floors.items() if floor > FLOORS} == {}


def test_cypher_of_the_search_is_short_and_in_files():
    texts = [path.read_text("utf-8") for folder in SEARCH for path in (ROOT / "queries" / folder).glob("*.cypher")]
    assert len(texts) > 30 and sum(len(text.splitlines()) for text in texts) <= CYPHER
    writers = {name for name, path in modules().items() if any(READS.search(text) for text in texts_in(path))}
    # The compiler makes statements of plans; `queries.graph` reads the rows of any graph.
    assert {name.rpartition(".")[0] for name in writers} == {"queries.compiler", "queries.graph"}


def test_no_column_of_a_parquet_file_is_replaced_by_the_name_of_a_folder():
    """DuckDB and `pyarrow.parquet.read_table` take a folder `run_id=7` as a column; `ParquetFile` does not."""
    texts = {name: path.read_text("utf-8") for name, path in modules().items()}
    texts |= {path.name: path.read_text("utf-8") for path in (ROOT / "queries").rglob("*.sql")}
    reads = {name: len(re.findall(r"(read_parquet|parquet_scan|read_json\w*)\(", text)) for name, text in texts.items()}
    assert {name: count for name, count in reads.items() if count} == {"queries.sql": 2}
    assert "hive_partitioning=false" in texts["queries.sql"]
    guessing = re.compile(r"\bpq\.read_(table|pandas)|ParquetDataset|pyarrow\.dataset|FROM '[^']*parquet'")
    assert [name for name, text in texts.items() if guessing.search(text)] == []


def texts_in(path):
    """The texts of a module but its docstrings."""
    nodes = [*ast.walk(parsed(path))]
    docs = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    found = (node for node in nodes if isinstance(node, ast.Constant) and id(node) not in docs)
    return [node.value for node in found if isinstance(node.value, str)]


def test_docstrings_and_comments_are_standard_english():
    bounds = house.PATTERNS | dict.fromkeys(house.BUDGETS, house.ROOM_HITS)
    assert {name: rate for name, rate in house.hits().items() if rate > bounds[name]} == {}


def test_names_parameters_and_lines_keep_to_their_bounds():
    assert house.weak_share() <= house.WEAK_SHARE
    assert [module.name for module in house.modules() if module.parameters > house.PARAMETERS] == []
    assert [module.name for module in house.modules() if module.line > house.LINE] == []


def test_the_bounds_notice_what_exceeds_them(tmp_path, monkeypatch):
    text = '"""Whoever stands where nobody is told."""\n\n# A note.\nimport os\ndef one(own, found):\n    return own\n'
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent" / "new.py").write_text(text)
    monkeypatch.setattr(house, "ROOT", tmp_path)
    found = house.measure("agent/new.py")
    assert (found.room, found.code, found.words, found.hits.total()) == ("agent", 2, 9, 4)
    assert (found.identifiers, found.weak, found.parameters) == (3, 3, 2)


def test_a_package_and_a_module_never_share_a_name():
    for path in modules().values():
        assert path.name == "__init__.py" or not path.with_suffix("").is_dir(), path


@pytest.mark.parametrize("package", PACKAGES)
def test_a_public_name_means_one_thing(package):
    """Within a package, a public name is defined in one module."""
    places = defaultdict(set)
    for name, path in modules().items():
        if name.partition(".")[0] == package:
            for defined in public_names(path):
                places[defined].add(name)
    assert {name: where for name, where in places.items() if len(where) > 1 and name not in REPEATED} == {}


def public_names(path):
    for node in parsed(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [target.id for target in targets if isinstance(target, ast.Name)]
        else:
            continue
        yield from (name for name in names if not name.startswith("_"))


def test_every_public_definition_says_what_it_is():
    """Modules, classes and functions with a public name have a docstring."""
    for name, path in modules().items():
        tree = parsed(path)
        silent = [] if not tree.body or ast.get_docstring(tree) else [name]
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                silent += [] if ast.get_docstring(node) else [f"{name}.{node.name}"]
        assert not silent, silent
