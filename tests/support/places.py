"""Folders that tests read."""

import os
from pathlib import Path

SUPPORT = Path(__file__).parent
TESTS = SUPPORT.parent
ROOT = TESTS.parent
DOCS = ROOT / "docs"
SNAPSHOTS = TESTS / "snapshots"
REAL = Path(os.environ.get("JRDB_REAL", ROOT.parent / "shared" / "jrdb-real"))
"""Real annotations, which are not part of the repository: tests that need them are skipped where they are absent."""
