"""Fuzz the program from outside: replies of models and prediction files.

    python tests/fuzz/run.py                                     about a minute, as the gate runs it
    python tests/fuzz/run.py --replies 100000  for half an hour and more
    python tests/fuzz/run.py --only replies --case 17            one case again

Everything follows from the seed and the number of a case. A case fails where something else than an error of
`schema/errors.py` is raised, a check of its module does not hold, a call takes more than 10 seconds of the processor,
or its process needs more than 2 GB. Its inputs and its traceback are left in the folder of findings, and the exit code
is 1. Progress names the next case: `--first` goes on from there.
"""

from __future__ import annotations

import argparse
import importlib
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from functools import partial
from pathlib import Path

HERE = Path(__file__).resolve().parent
KINDS = {"replies": 10_000, "predictions": 1500}
"""What is fuzzed, each a module with a function `run_case`; and how many items are tried if nothing else is said."""

MEMORY = 2 << 30
MOST_FINDINGS = 20
PROGRESS_S = 30


def main():
    options = parse(sys.argv[1:])
    sys.path[:0] = [str(HERE), str(HERE.parent / "support"), str(HERE.parents[2])]
    if options.worker:
        return work(options)
    options.findings.mkdir(parents=True, exist_ok=True)
    started, found = time.monotonic(), 0
    kinds = [options.only] if options.only else list(KINDS)
    for kind in kinds:
        most = 1 if options.case is not None else getattr(options, kind)
        found += fuzz(kind, most, options) if most else 0
    seconds = time.monotonic() - started
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{found} findings in {seconds:.0f} s ({usage.ru_utime + usage.ru_stime:.0f} s of one core), "
        f"at most {usage.ru_maxrss / 1024:.0f} MB a process"
    )
    if found:
        print(f"see {options.findings}")
    return 1 if found else 0


def parse(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for kind, most in KINDS.items():
        parser.add_argument(
            f"--{kind}", type=int, default=most, metavar="N", help=f"{kind} to try, {most} if not given"
        )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=KINDS, help="one kind alone")
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--case", type=int, help="one case alone; with --only")
    parser.add_argument("--findings", type=lambda path: Path(path).resolve(), default="fuzz-findings")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.case is not None:
        options.first = options.case
    return options


def fuzz(kind, most, options):
    """Try cases of a kind until so many items are done; the number of findings.

    A worker process runs the cases and prints a line for each. One that dies or hangs is replaced.
    """
    case, done, found, told = options.first, 0, 0, 0.0
    started = time.monotonic()
    while done < most and found < MOST_FINDINGS:
        command = [sys.executable, __file__, "--worker", kind, "--seed", str(options.seed), "--first", str(case)]
        with (
            tempfile.TemporaryDirectory(prefix="fuzz-") as folder,
            subprocess.Popen(
                [*command, "--findings", str(options.findings)], stdout=subprocess.PIPE, text=True, cwd=folder
            ) as worker,
        ):
            for line in worker.stdout:
                word, *numbers = line.split()
                if word == "finding":
                    found += 1
                    print(
                        f"{kind}: case {case} fails, see {options.findings / f'{kind}-{options.seed}-{case}'}",
                        flush=True,
                    )
                elif word == "done":
                    done += int(numbers[1])
                else:
                    continue
                case += 1
                if time.monotonic() - told > PROGRESS_S or done >= most:
                    told = time.monotonic()
                    print(f"{kind}: {done:,} of {most:,} in {told - started:.0f} s, next case {case}", flush=True)
                if done >= most or found >= MOST_FINDINGS or options.case is not None:
                    worker.kill()
                    return found
        # It ended by itself: it hung, grew too large or crashed.
        found += 1
        place = options.findings / f"{kind}-{options.seed}-{case}"
        place.mkdir(parents=True, exist_ok=True)
        (place / "ended.txt").write_text(f"exit code {worker.returncode}\n")
        print(f"{kind}: case {case} ended its process ({worker.returncode}), see {place}", flush=True)
        case += 1
    return found


# -- the worker ----------------------------------------------------------------------------------------------------


def work(options):
    """Run cases for ever, a line each."""
    kind = options.worker
    limits, module = importlib.import_module("limits"), importlib.import_module(kind)
    folder, case = Path.cwd(), options.first
    threading.Thread(target=watch_memory, daemon=True).start()
    module.prepare(folder)
    while True:
        place = options.findings / f"{kind}-{options.seed}-{case}"
        try:
            count = module.run_case(options.seed, case, folder, partial(save, place))
        except Exception as error:
            limits.end()
            save(place, "traceback.txt", "".join(traceback.format_exception(error)).encode("utf-8", "replace"))
            print("finding", case, flush=True)
        else:
            limits.end()
            print("done", case, count, flush=True)
        case += 1


def save(place, name, content):
    """Keep an input of a failing case: its bytes, or a folder that a function fills."""
    path = place / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if callable(content):
        content(path)
    else:
        path.write_bytes(content)


def watch_memory():
    while True:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        if pages * resource.getpagesize() > MEMORY:
            print(f"more than {MEMORY >> 30} GB", file=sys.stderr, flush=True)
            os._exit(3)
        time.sleep(0.05)


if __name__ == "__main__":
    sys.exit(main())
