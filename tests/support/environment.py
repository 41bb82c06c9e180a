"""Folders that tests read, the number of examples they try, and extras that they need."""

import importlib.util
import os
import shutil
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parent
TESTS = SUPPORT.parent
ROOT = TESTS.parent
DOCS = ROOT / "docs"
SNAPSHOTS = TESTS / "snapshots"
REAL = Path(os.environ.get("JRDB_REAL", ROOT.parent / "shared" / "jrdb-real"))
"""Real annotations, which are not part of the repository: tests that need them are skipped where they are absent."""


needs_real = pytest.mark.skipif(not REAL.exists(), reason="the real annotations are not here")


def copy_real(folder, first=0, last=None):
    """Copy the 2D labels of some real sequences, in the order of their size, into the root `folder`/root."""
    target = folder / "root" / "labels" / "labels_2d_stitched"
    target.mkdir(parents=True)
    every = sorted((REAL / "labels" / target.name).glob("*.json"), key=lambda path: path.stat().st_size)
    for path in every[first:last]:
        shutil.copy(path, target)


DEEP = os.environ.get("HYPOTHESIS_PROFILE") == "deep"


def examples(gate):
    """For `settings(max_examples=...)` of tests whose examples are dear."""
    return 20 * gate if DEEP else gate


def needs(*modules):
    """Skip a file of tests where an extra is missing; its tests import it, which takes up to two seconds."""
    for module in modules:
        found = importlib.util.find_spec(module)
        # Without an origin it is a mere folder of that name.
        if found is None or found.origin is None:
            assert not os.environ.get("REQUIRE_EXTRAS"), f"{module} is not installed"
            pytest.skip(f"{module} is not installed", allow_module_level=True)
