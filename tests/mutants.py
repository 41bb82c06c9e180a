"""Check the power of the tests: `python tests/mutants.py [--area AREA ...] [--check-only]`.

A mutant is a small fault put into one module: a score that is too lenient, a proof that is skipped, a word that the
guard lets through. `mutants.toml` lists them by area. The script applies them one at a time in a temporary copy of the
repository and runs the tests that must notice. It ends with exit code 1 if a mutant survives, or if the code that it
replaces no longer occurs exactly once or a test of it is gone: then change its row along with the code. `--check-only`
only looks for the code and the tests, which takes a second.
"""

from __future__ import annotations

import argparse
import compileall
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import NamedTuple

TREE = Path(__file__).resolve().parents[1]
TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
TIMEOUT_S = 600


class Mutant(NamedTuple):
    """A fault: `old` becomes `new` in a file, and one of the tests must fail."""

    area: str
    file: str
    fault: str
    old: str
    new: str
    tests: tuple[str, ...]


def mutants(areas: list[str]) -> Iterator[Mutant]:
    """The rows of these areas, or of all."""
    for area in areas or TABLE:
        for row in TABLE[area]:
            yield Mutant(area, **row | {"tests": tuple(map(test_path, row["tests"]))})


def test_path(name: str) -> str:
    """The path of a test given as `file::test`, wherever the file lies under tests/."""
    stem, _, test = name.partition("::")
    (file,) = (TREE / "tests").rglob(f"{stem}.py")
    return f"{file.relative_to(TREE)}{'::' if test else ''}{test}"


def out_of_date(mutant: Mutant) -> str:
    """Why a mutant's row no longer fits the tree, or ""."""
    path = TREE / mutant.file
    if (count := path.read_text().count(mutant.old) if path.exists() else 0) != 1:
        return f"the fragment occurs {count} times in {mutant.file}: {mutant.old!r}"
    for name in mutant.tests:
        file, _, test = name.partition("::")
        if test and f"def {test.partition('[')[0]}(" not in (TREE / file).read_text():
            return f"there is no test {name}: {mutant.fault}"
    return ""


def copy_tree(folder: Path) -> Path:
    """Copy the files of the repository, also those not yet committed, as the package `jrdb_avr`.

    Compiled modules are checked by their text: two mutants of one length within a second have the same time and size.
    """
    copy = folder / "jrdb_avr"
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=TREE, check=True, capture_output=True, text=True)
    for name in listed.stdout.split("\0"):
        if (TREE / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(TREE / name, copy / name)
    compileall.compile_dir(copy, quiet=1, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return copy


def run_tests(copy: Path, tests: tuple[str, ...]) -> tuple[int, str]:
    """Exit code of pytest in the copy, and the first test that failed (or the end of what it printed)."""
    command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "--tb=line", "-rfE", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(copy.parent)}
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return -1, f"stopped after {TIMEOUT_S} s"
    failed = re.search(r"^(?:FAILED|ERROR) (tests.*?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return done.returncode, failed[1] if failed else (done.stdout + done.stderr).strip()[-300:]


def verdict(copy: Path, mutant: Mutant) -> tuple[bool, str]:
    """Whether the mutant is caught, and how."""
    path = copy / mutant.file
    sound = path.read_text()
    path.write_text(sound.replace(mutant.old, mutant.new))
    try:
        code, what = run_tests(copy, mutant.tests)
    finally:
        path.write_text(sound)
    # 1: a test failed. Other codes are no verdict: nothing was collected, or the mutant cannot be imported.
    return code == 1, f"caught by {what}" if code == 1 else "SURVIVED" if code == 0 else f"NOT RUN ({code}): {what}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--area", action="append", default=[], choices=[*TABLE])
    parser.add_argument("--check-only", action="store_true", help="only look whether fragments and tests are there")
    options = parser.parse_args()
    chosen = list(mutants(options.area))
    bad: list[Mutant] = []
    usable = []
    for mutant in chosen:
        if reason := out_of_date(mutant):
            bad.append(mutant)
            print(f"{mutant.area:10} {reason}")
        else:
            usable.append(mutant)
    if not options.check_only:
        with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
            copy = copy_tree(Path(folder))
            tests = tuple(dict.fromkeys(test for mutant in usable for test in mutant.tests))
            code, what = run_tests(copy, tests)
            if code != 0:
                sys.exit(f"without a mutant the tests end with code {code}: {what}")
            for mutant in usable:
                begin = time.monotonic()
                caught, how = verdict(copy, mutant)
                bad += [] if caught else [mutant]
                seconds = time.monotonic() - begin
                print(f"{mutant.area:10} {mutant.file}: {mutant.fault}: {how} ({seconds:.0f} s)", flush=True)
    counts = Counter(mutant.area for mutant in chosen)
    of_areas = ", ".join(f"{count} {area}" for area, count in counts.items())
    done = "in place" if options.check_only else "caught"
    print(f"{len(chosen) - len(bad)} of {len(chosen)} mutants {done} ({of_areas})")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
