"""Run every command on a full disk, a read-only one, beside a second writer, in a moved store, in a store of a newer
version, and while the clock is set back.

    python tests/kills/disk.py --seed 1                        all; exit code 1 and what was wrong on a finding
    python tests/kills/disk.py --only full --case generate     one trouble, one command

A command either ends well, with the files of an undisturbed run, or in one line that says what to do, with exit code 1,
no traceback, and nothing lost: no file is half-written, and the rerun without the trouble ends like an undisturbed run.
A small disk is a tmpfs, which needs root (left out otherwise); "full" has the library of the matrix refuse all writes
from a random one on, which needs no root.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from cases import Finding, Running, await_group, differences, half_written, snapshot
from matrix import Matrix, progress

READING = (
    ("stats",),
    ("validate",),
    ("cypher", "MATCH (p:Person) RETURN count(*) AS n"),
    ("sql", "SELECT count(*) FROM questions"),
    ("runs", "list"),
    ("runs", "show", "r"),
    ("report", "r", "a"),
    ("load", "--verify"),
)
"""Commands that only read."""


class Disk(Matrix):
    """The troubles, by name: each takes a case, and returns what was wrong."""

    def run(self, words, **faults):
        """Run a command to its end: its exit code and standard error."""
        running = self.start(words, **faults)
        code = running.wait()
        await_group(running.process.pid)
        return code, running.said()

    def ended(self, case, code, said, after, *, rerun=None):
        """What is wrong after a command that had trouble: it ended badly, left half a file, or spoilt its rerun."""
        before, half, whole, *_ = self.whole(case)
        yield from fault_of(code, said)
        if code == 0:
            # Where a graph has no room for its checkpoint, its log holds the rest.
            found = {name: own for name, own in snapshot(self.work).items() if not name.endswith((".wal", ".shadow"))}
            yield from differences(found, whole)
            return
        yield from half_written(after, before, half)
        if rerun is not None:
            code, said = self.run(rerun)
            if (code and case.done not in said) or "Traceback" in said:
                yield f"the rerun ended with {code}: {said.strip()[-1000:]}"
            else:
                yield from differences(snapshot(self.work), whole)

    def full(self, case, rng):
        """No write finds room from a random one on."""
        writes = [number for number, kind, _ in self.whole(case)[-1] if kind == "write"]
        for number in rng.sample(writes, min(self.times, len(writes))):
            self.reset(case)
            code, said = self.run(case.words, at=int(number), do="full")
            after = snapshot(self.work, graphs=False)
            yield from (f"write {number}: {line}" for line in self.ended(case, code, said, after, rerun=case.rerun))

    def small(self, case, rng):
        """A disk of its own that has no room at the start, in the middle, and short of the end."""
        self.whole(case)
        self.reset(case)
        need = self.need(case)
        for room in [0, 64 << 10, *(int(need * rng.random()) for _ in range(self.times)), need + (40 << 20)]:
            with mounted(self.base / case.state, self.work) as resize:
                resize(shutil.disk_usage(self.work).used + room)
                code, said = self.run(case.words)
                after = snapshot(self.work, graphs=False)
                resize(1 << 30)
                yield from (f"{room} bytes: {line}" for line in self.ended(case, code, said, after, rerun=case.rerun))

    def need(self, case):
        """The bytes that a command adds."""
        with mounted(self.base / case.state, self.work):
            before = shutil.disk_usage(self.work).used
            self.run(case.words)
            return max(0, shutil.disk_usage(self.work).used - before)

    def readonly(self, case, rng):
        """A disk that nobody can write to; commands that only read work there."""
        with mounted(self.base / case.state, self.work):
            before = snapshot(self.work)
            subprocess.run(["mount", "-o", "remount,ro", self.work], check=True)
            code, said = self.run(case.words)
            yield from fault_of(code, said)
            if not code and case.words[0] != "report":
                yield "it ended well"
            if case.name == "report":
                for words in READING:
                    code, said = self.run((*words, "--store", "store"))
                    if code or "Traceback" in said:
                        yield f"{' '.join(words)} ended with {code}: {said.strip()[-1000:]}"
            yield from differences(snapshot(self.work), before)

    def second(self, case, rng):
        """The same command twice at once: one of them may be refused."""
        self.whole(case)
        self.reset(case)
        (first := self.work.with_name("one")).mkdir(exist_ok=True)
        (other := self.work.with_name("two")).mkdir(exist_ok=True)
        both = [Running(case.words, self.work, first), Running(case.words, self.work, other)]
        codes = [running.wait() for running in both]
        for running, code in zip(both, codes, strict=True):
            await_group(running.process.pid)
            yield from fault_of(code, running.said())
        self.outcomes[f"second {case.name}", *sorted(codes)] += 1
        code, said = self.run(case.rerun)
        if code and case.done not in said and "exists" not in said:
            yield f"the rerun ended with {code}: {said.strip()[-1000:]}"
        yield from differences(snapshot(self.work), self.whole(case)[2])

    def moved(self, case, rng):
        """The store lies elsewhere than when it was loaded."""
        whole, place = self.whole(case)[2], self.work
        self.reset(case)
        self.work = place.rename(place.with_name("elsewhere"))
        try:
            code, said = self.run(case.words)
            if code:
                yield f"it ended with {code}: {said.strip()[-1000:]}"
            yield from differences(snapshot(self.work), whole)
        finally:
            shutil.rmtree(self.work)
            self.work = place

    def newer(self, case, rng):
        """The store was written by a newer version: it is refused, and stays as it is."""
        self.reset(case)
        manifest = self.work / "store/store.json"
        if not manifest.exists():
            return
        known = json.loads(manifest.read_bytes())
        manifest.write_text(json.dumps({**known, "version": known["version"] + 1, "sequences": ["another form"]}))
        before = snapshot(self.work, graphs=False)
        code, said = self.run(case.words)
        yield from fault_of(code, said)
        after = snapshot(self.work, graphs=False)
        if "newer" not in said and case.name != "sample":
            yield f"it does not say that the store is newer: {said.strip()[-300:]}"
        yield from differences(after, before)

    def clock(self, case, rng):
        """The clock is set back by a day in the middle."""
        changes = len(self.whole(case)[-1])
        self.reset(case)
        code, said = self.run(case.words, at=rng.randint(1, changes), do="clock")
        if code or "Traceback" in said:
            yield f"it ended with {code}: {said.strip()[-1000:]}"
        else:
            yield from differences(snapshot(self.work), self.whole(case)[2])


def fault_of(code, said):
    """What is wrong with how a command ended."""
    if "Traceback" in said:
        yield f"a traceback: {said.strip()[-1500:]}"
    elif code not in (0, 1):
        yield f"it ended with {code}: {said.strip()[-1000:]}"
    elif code == 1:
        lines = [line for line in said.splitlines() if line.startswith("jrdb-avr: ")]
        if len(lines) != 1:
            yield f"not one line: {said.strip()[-1000:]}"


@contextlib.contextmanager
def mounted(state, folder):
    """A disk of its own at a folder, with a copy of a state, and a function that makes it another size in bytes."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1g", "none", folder], check=True)
    try:
        shutil.copytree(state, folder, dirs_exist_ok=True)
        # Of a size of 0 there is no limit.
        yield lambda size: subprocess.run(["mount", "-o", f"remount,size={max(size, 4096)}", folder], check=True)
    finally:
        subprocess.run(["umount", folder], check=True)


NEEDS_ROOT = ("small", "readonly")
TROUBLES = ("full", "small", "readonly", "second", "moved", "newer", "clock")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--times", type=int, default=3, help="random points of each command where the disk is full")
    parser.add_argument("--only", action="append", choices=TROUBLES, metavar="TROUBLE", help=", ".join(TROUBLES))
    parser.add_argument("--case", action="append", metavar="CASE", help="these commands alone")
    parser.add_argument("--folder", type=Path, default=Path("/tmp/jrdb-avr-kills"))
    options = parser.parse_args()
    start, rng = time.monotonic(), random.Random(options.seed)
    disk = Disk(options.folder.resolve())
    disk.times, disk.outcomes = options.times, Counter()
    done = Counter()
    for trouble in options.only or TROUBLES:
        if trouble in NEEDS_ROOT and os.geteuid():
            progress(f"{trouble} is left out: it mounts a disk, which needs root")
            continue
        for case in disk.cases:
            if options.case and case.name not in options.case:
                continue
            try:
                wrong = list(getattr(disk, trouble)(case, rng))
            except Finding as finding:
                wrong = [str(finding)]
            done[trouble] += 1
            if wrong:
                disk.findings.append(case)
                print(f"FINDING {trouble}, {case.name}", *wrong[:8], sep="\n    ", flush=True)
        progress(f"{trouble}: {done[trouble]} commands")
    for outcome, number in sorted(disk.outcomes.items(), key=repr):
        print(*outcome, number)
    print(f"{sum(done.values())} trials in {time.monotonic() - start:.0f} s, {len(disk.findings)} findings")
    sys.exit(bool(disk.findings))


if __name__ == "__main__":
    main()
