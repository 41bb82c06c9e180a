"""Run every command on a full disk and beside a second writer.

    python tests/kills/disk.py --seed 1                        all; exit code 1 and what was wrong on a finding
    python tests/kills/disk.py --only full --case generate     one trouble, one command

A command either ends well, with the files of an undisturbed run, or in one line that says what to do, with exit code 1,
no traceback, and nothing lost: no file is half-written, and the rerun without the trouble ends like an undisturbed run.
The library of the matrix refuses all writes from a random one on.
"""

import argparse
import random
import sys
import time
from collections import Counter
from pathlib import Path

from cases import Finding, Running, await_group, differences, half_written, snapshot
from matrix import Matrix, progress


class Disk(Matrix):
    """The troubles, by name: each takes a case, and returns what was wrong."""

    def run(self, words, **faults):
        """Run a command to its end: its exit code and standard error."""
        running = self.start(words, **faults)
        code = running.wait()
        await_group(running.process.pid)
        return code, running.said()

    def ended(self, case, code, said, after, *, rerun):
        """What is wrong after a command that had trouble: it ended badly, left half a file, or spoilt its rerun."""
        before, half, whole, *_ = self.whole(case)
        yield from fault_of(code, said)
        if code == 0:
            # Where a graph has no room for its checkpoint, its log holds the rest.
            found = {name: own for name, own in snapshot(self.work).items() if not name.endswith((".wal", ".shadow"))}
            yield from differences(found, whole)
            return
        yield from half_written(after, before, half)
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


TROUBLES = ("full", "second")


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
