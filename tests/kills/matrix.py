"""Kill commands at random moments and at every change of the disk; their reruns must end as if nothing had been.

    python tests/kills/matrix.py --kills 100 --seed 1          both parts; exit code 1 and what differed on a finding
    python tests/kills/matrix.py --kills 0 --only generate     every rename and journal write of `generate` alone

Part one kills the command, one of its children or its whole group at a random moment. Part two preloads a library
(`faults.c`, built with gcc) that kills the group or the one process before every rename, within or after every write to
a journal, and after one removal, truncation and half a write of every kind of file. After each kill no file may be
half-written; after the rerun every file is that of an undisturbed run, and none is left over. What may differ: times,
numbers of processes, the port of the built-in model's server, its log and what the checks of it found, the number of
reads and writes of the world model in run.json, and the order of lines in a journal. Of a graph file the rows count.
"""

import argparse
import random
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from cases import Finding, Running, all_cases, await_group, differences, half_written, make_states, snapshot

NAMED = ("load", "generate", "evaluate", "evaluate agent", "score", "report", "export hf", "play")
"""The cases of the random kills."""
WHOM = ("parent", "child", "group")
BUSY = re.compile(r"is (in use|being written|being run) by")


class Matrix:
    """The undisturbed runs, the trials, and what they found."""

    def __init__(self, folder):
        self.base, self.work, self.trace = folder / "states", folder / "work", folder / "trace"
        make_states(self.base)
        self.cases = all_cases(self.base)
        self.library = folder / "faults.so"
        source = Path(__file__).with_name("faults.c")
        subprocess.run(["gcc", "-shared", "-fPIC", "-O2", "-o", self.library, source, "-ldl"], check=True)
        self.findings, self.counts, self.waited = [], Counter(), 0
        self._whole = {}

    def whole(self, case):
        """An undisturbed run: the files before and after it, its seconds, and its changes of the disk."""
        if case.name not in self._whole:
            self.reset(case)
            before = snapshot(self.work, graphs=False)
            start = time.monotonic()
            running = self.start(case.words, counted=True)
            code = running.wait()
            seconds = time.monotonic() - start
            await_group(running.process.pid)
            if code:
                raise SystemExit(f"{case.name}: an undisturbed run ended with {code}: {running.said()}")
            changes = [line.split(" ", 2) for line in (self.trace / "log").read_text().splitlines()]
            half = snapshot(self.work, graphs=False)
            self._whole[case.name] = before, half, snapshot(self.work), seconds, changes
        return self._whole[case.name]

    def reset(self, case):
        shutil.rmtree(self.work, ignore_errors=True)
        shutil.copytree(self.base / case.state, self.work)

    def start(self, words, *, counted=False, at=None, do="before", whom="group"):
        shutil.rmtree(self.trace, ignore_errors=True)
        self.trace.mkdir()
        if not counted and at is None:
            return Running(words, self.work, self.trace)
        (self.trace / "state").write_bytes(bytes(8))
        places = {"ROOT": self.work, "STATE": self.trace / "state", "LOG": self.trace / "log"}
        faults = {f"FAULTS_{name}": str(path) for name, path in places.items()}
        if at is not None:
            faults |= {"FAULTS_AT": str(at), "FAULTS_DO": do, "FAULTS_WHOM": whom}
        return Running(words, self.work, self.trace, LD_PRELOAD=str(self.library), **faults)

    # -- trials ----------------------------------------------------------------------------------------------------

    def at_moment(self, case, share, whom):
        """Kill at a share of the time that an undisturbed run takes; False where it had ended by then."""
        *_, seconds, _ = self.whole(case)
        self.reset(case)
        running = self.start(case.words)
        end = time.monotonic() + share * seconds
        while time.monotonic() < end and running.code is None:
            time.sleep(0.005)
        if running.code is not None:
            return False
        whom = running.kill(whom)
        running.wait()
        self.counts[case.name, whom] += 1
        self.judge(case, running, f"{whom} killed after {share * seconds:.2f} s")
        return True

    def at_change(self, case, number, kind, path, do, whom):
        """Kill at a change of the disk."""
        self.reset(case)
        running = self.start(case.words, at=number, do=do, whom=whom)
        running.wait()
        log = (self.trace / "log").read_text().splitlines()
        if len(log) < number:
            return False
        what = log[number - 1].split(" ", 1)[1]
        self.counts[case.name, kind] += 1
        self.judge(case, running, f"{whom} killed {do} change {number}, {what}")
        return True

    def judge(self, case, running, how):
        """Look at what a kill left, run again, and compare; whatever is wrong is a finding."""
        before, half, after, *_ = self.whole(case)
        try:
            wrong = [f"a child was killed: {running.said()[-2000:]}"] if "Traceback" in running.said() else []
            wrong += half_written(snapshot(self.work, graphs=False), before, half)
            again = self.start(case.rerun)
            code = again.wait()
            if code == 1 and BUSY.search(again.said()):
                # What was not killed ends first.
                self.waited += 1
                await_group(running.process.pid)
                again = self.start(case.rerun)
                code = again.wait()
            await_group(running.process.pid)
            await_group(again.process.pid)
            if (code and case.done not in again.said()) or "Traceback" in again.said():
                wrong.append(f"the rerun ended with {code}: {again.said().strip()[-2000:]}")
            else:
                wrong += differences(snapshot(self.work), after)
        except Finding as finding:
            wrong = [str(finding)]
        if wrong:
            self.findings.append((case.name, how, wrong))
            print(f"FINDING {case.name}: {how}", *wrong[:8], sep="\n    ", flush=True)

    # -- the parts ---------------------------------------------------------------------------------------------------

    def random_kills(self, kills, rng, cases):
        done = 0
        while cases and done < kills:
            case, whom = cases[done % len(cases)], WHOM[done // len(cases) % len(WHOM)]
            if self.at_moment(case, rng.random(), whom):
                done += 1
                if not done % 10:
                    progress(f"{done} of {kills} random kills")

    def every_change(self, case, rng, share):
        points = [point for point in chosen(self.whole(case)[-1], rng) if rng.random() < share]
        missed = sum(not self.at_change(case, *point) for point in points)
        progress(f"{case.name}: {len(points) - missed} faults, {missed} not reached")


def chosen(changes, rng):
    """The points of faults: (number, kind, path, how, whom).

    Before every rename and link, and within or after every write to a journal; after one change of each kind and place,
    or in the middle of it where it is a write. Places that differ by a sequence, a table or a random name are one.
    """
    kinds = {}
    for number, kind, path in changes:
        point = int(number), kind, path
        kinds.setdefault((kind, place_of(path)), []).append(point)
        if kind in ("rename", "link"):
            yield *point, "before", rng.choice(("group", "self"))
        elif "/journal/" in path or path.endswith("calls.jsonl"):
            yield *point, rng.choice(("torn", "after")), "group"
    for (kind, _), points in kinds.items():
        yield *rng.choice(points), "torn" if kind == "write" else "after", rng.choice(("group", "self"))


def place_of(path):
    """The place of a path, without the names of sequences and tables and of what is drawn at random."""
    path = re.sub(r"sample-[a-z]+-\d+_\d|\.[a-z0-9_]{8}\.tmp", "*", path)
    return re.sub(r"(annotations|intervals|scene|\.keyframes|questions|\.pending|data)/[^/]+(/[^/]+)?$", r"\1/*", path)


def progress(text):
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100, help="random kills")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", metavar="CASE", help="these cases alone")
    parser.add_argument("--no-faults", action="store_true", help="random kills alone")
    parser.add_argument("--share", type=float, default=1.0, help="share of the faults that is injected")
    parser.add_argument("--folder", type=Path, default=Path("/tmp/jrdb-avr-kills"))
    options = parser.parse_args()
    start, rng = time.monotonic(), random.Random(options.seed)
    matrix = Matrix(options.folder.resolve())
    if unknown := set(options.only or ()) - {case.name for case in matrix.cases}:
        parser.error(f"no case {', '.join(sorted(unknown))}: {', '.join(case.name for case in matrix.cases)}")
    cases = [case for case in matrix.cases if not options.only or case.name in options.only]
    matrix.random_kills(options.kills, rng, [case for case in cases if options.only or case.name in NAMED])
    for case in () if options.no_faults else cases:
        matrix.every_change(case, rng, options.share)
    print("case                what killed       times")
    for (name, what), number in sorted(matrix.counts.items()):
        print(f"{name:<20}{what:<16}{number:>7}")
    print(
        f"{sum(matrix.counts.values())} kills in {time.monotonic() - start:.0f} s, {len(matrix.findings)} findings; "
        f"{matrix.waited} reruns waited for what was not killed"
    )
    sys.exit(bool(matrix.findings))


if __name__ == "__main__":
    main()
