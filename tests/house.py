"""Measure the program's code lines per room and its language: `python tests/house.py` prints both.

`tests/test_architecture.py` holds the measures. Code lines are without blanks, comments, docstrings and imports.
"""

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
BUDGETS = {
    "schema": 2800,
    "loaders": 4900,
    "queries": 2400,
    "engine/generate": 2300,
    "engine/rederive": 1200,
    "engine/validate": 600,
    "engine/observe": 230,
    "engine/run": 1650,
    "engine/report": 1300,
    "engine/pages": 1200,
    "engine/integrations": 900,
    "engine/commands": 1500,
    "engine": 350,
    "agent/model": 1250,
    "agent/methods": 545,
    "agent/simulated": 950,
    "agent": 2600,
    "__init__.py": 60,
}
"""Maximum number of code lines per room. `engine` and `agent` are the modules that no other row counts."""
TOTAL = 26_750
TESTS = 31_000
"""Maximum number of code lines of the program, and of everything below `tests/`."""
PATTERNS = {
    r"\bwhere\b": 3.0,
    r"\b(whom|whoever|whomever|whose)\b": 0.1,
    r"\b(somebody|nobody|anybody|everybody)\b": 0.1,
    r"\b(is|are|was|were) (no|none)\b": 0.9,
    r"\b(those|that|as) of\b": 0.3,
    r"\b(by|of|in|at|to|for|from) which\b": 0.6,
    r"\b(stands?|lies|tells?|told)\b": 0.3,
    r"\bbut for\b": 0.05,
}
"""Maximum number of hits per 1,000 words of docstrings and comments, by pattern."""
ROOM_HITS = 8.0
"""The same of all patterns together, within one room."""
WEAK_NAMES = frozenset(
    {"one", "own", "other", "found", "place", "places", "number", "who", "told", "said", "seen", "there", "here"}
    | {"known", "away", "mine", "yours", "wanted", "words", "many", "way"}
)
WEAK_SHARE = 60
"""Maximum number of weak names per 10,000 identifiers."""
PARAMETERS = 12
LINE = 128
"""Maximum number of parameters of a function, and of characters in a line."""


class Module(NamedTuple):
    """The measures of one file."""

    name: str
    room: str
    code: int
    words: int
    hits: Counter
    identifiers: int
    weak: int
    parameters: int
    line: int


@cache
def modules() -> tuple[Module, ...]:
    """Measure the modules of the program."""
    return tuple(map(measure, ["__init__.py", *files("agent", "engine", "loaders", "queries", "schema")]))


def lines_of_tests() -> int:
    """Count the code lines below `tests/`."""
    return sum(code_lines((ROOT / name).read_text("utf-8")) for name in files("tests"))


def files(*folders: str) -> list[str]:
    """List the Python files below folders, as paths relative to the tree."""
    return sorted(path.relative_to(ROOT).as_posix() for folder in folders for path in (ROOT / folder).rglob("*.py"))


def measure(name: str) -> Module:
    """Measure a file of the tree."""
    text = (ROOT / name).read_text("utf-8")
    nodes = list(ast.walk(ast.parse(text)))
    prose = "\n".join(re.sub(r"`[^`]*`", "X", part) for part in texts_of(text, nodes))
    identifiers = [
        getattr(node, "id", getattr(node, "arg", getattr(node, "attr", "")))
        for node in nodes
        if isinstance(node, ast.Name | ast.arg | ast.Attribute)
    ]
    functions = [node.args for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return Module(
        name,
        room_of(name),
        code_lines(text),
        len(prose.split()),
        Counter({pattern: len(re.findall(pattern, prose)) for pattern in PATTERNS}),
        len(identifiers),
        sum(identifier in WEAK_NAMES for identifier in identifiers),
        max((len(args.posonlyargs + args.args + args.kwonlyargs) for args in functions), default=0),
        max(map(len, text.splitlines()), default=0),
    )


def room_of(name: str) -> str:
    """Return the room of a file: its folder of two levels if that has a budget, else its first part."""
    parts = name.split("/")
    inner = "/".join(parts[:2])
    return inner if len(parts) > 2 and inner in BUDGETS else parts[0]


def code_lines(text: str) -> int:
    """Count the lines that hold code, without docstrings and imports."""
    numbered = enumerate(text.splitlines(), 1)
    lines = {i for i, line in numbered if line.strip() and not line.lstrip().startswith("#")}
    silent = set()
    for node in ast.walk(ast.parse(text)):
        if is_text(node) or isinstance(node, ast.Import | ast.ImportFrom):
            silent.update(range(node.lineno, node.end_lineno + 1))
        elif isinstance(node, ast.Constant | ast.JoinedStr):
            # Inside a string, blank lines and lines that begin with "#" are code.
            lines.update(range(node.lineno, node.end_lineno + 1))
    return len(lines - silent)


def texts_of(text: str, nodes: list[ast.AST]) -> list[str]:
    """Return the docstrings and comments of a file."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    comments = [token.string for token in tokens if token.type == tokenize.COMMENT]
    return [node.value.value for node in nodes if is_text(node)] + comments


def is_text(node: ast.AST) -> bool:
    """Return whether a node is a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def rooms() -> Counter:
    """Count the code lines of each room."""
    found = Counter()
    for module in modules():
        found[module.room] += module.code
    return found


def hits() -> dict[str, float]:
    """Return hits per 1,000 words: of each pattern in all modules, and of each room for all patterns."""
    total = Counter()
    for module in modules():
        total.update(module.hits)
    found = {pattern: 1000 * total[pattern] / sum(module.words for module in modules()) for pattern in PATTERNS}
    for room in rooms():
        inside = [module for module in modules() if module.room == room]
        words = sum(module.words for module in inside)
        # A rate of a few hundred words says little.
        found[room] = 1000 * sum(module.hits.total() for module in inside) / words if words > 300 else 0.0
    return found


def weak_share() -> float:
    """Return the number of weak names per 10,000 identifiers."""
    return 10_000 * sum(module.weak for module in modules()) / sum(module.identifiers for module in modules())


def main() -> None:
    """Print all measures beside their bounds."""
    rates = hits()
    for room, lines in sorted(rooms().items()):
        print(f"{room:22}{lines:8,}{BUDGETS.get(room, 0):8,}{rates[room]:8.1f}{ROOM_HITS:8.1f}")
    print(f"{'program':22}{rooms().total():8,}{TOTAL:8,}\n{'tests':22}{lines_of_tests():8,}{TESTS:8,}")
    for pattern, bound in PATTERNS.items():
        print(f"{pattern:58}{rates[pattern]:8.2f}{bound:8.2f}")
    print(f"{'weak names per 10,000 identifiers':58}{weak_share():8.0f}{WEAK_SHARE:8}")
    print(f"{'most parameters':58}{max(module.parameters for module in modules()):8}{PARAMETERS:8}")
    print(f"{'longest line':58}{max(module.line for module in modules()):8}{LINE:8}")


if __name__ == "__main__":
    sys.exit(main())
