"""Scoring and reporting at scale: `python tests/benchmarks/bench_report.py [STORE | --smallest]`.

25 stored runs of 2,098 predictions with their transcripts (`many_runs.py`). CPU seconds of each command, as a user
calls it, beside those of starting Python with the same modules. Bars: `score` 2 s in all, a whole report 3 s beyond the
start. Exit code 1 where one is missed.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import many_runs

START = "import jrdb_avr.engine.report.tables, jrdb_avr.engine.pages.report"
SCORE_S, REPORT_S = 2.0, 3.0


def cpu_seconds(*arguments):
    """CPU seconds, user and system, of a process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(one) for one in arguments], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main():
    smallest = sys.argv[1:] == ["--smallest"]
    if smallest:
        vars(many_runs).update(many_runs.SMALLEST)
    with tempfile.TemporaryDirectory() as folder:
        store = Path(sys.argv[1]) if sys.argv[1:] and not smallest else many_runs.write_runs(folder).path
        command = Path(sys.executable).with_name("jrdb-avr")
        start = min(cpu_seconds(sys.executable, "-c", START) for _ in range(3))
        score = min(cpu_seconds(command, "score", "--store", store) for _ in range(2))
        print(f"{many_runs.RUN_COUNT} runs x {many_runs.QUESTION_COUNT}; starting takes {start:.2f} CPU s")
        print(f"score                          {score:5.2f} CPU s (bar {SCORE_S:g}), {score / start:.1f} x the start")
        missed = score > SCORE_S
        formats = {"--json": (), "--markdown": (), "--latex": (), "--html": (Path(folder) / "report.html",)}
        for name, values in formats.items():
            tables = () if values else ("--table", "all")
            took = cpu_seconds(command, "report", "--store", store, "--paper", *tables, name, *values)
            beyond = took - start
            missed |= beyond > REPORT_S
            ratio = beyond / max(score - start, 0.01)
            print(
                f"report {name:<10} all tables   {took:5.2f} CPU s, {beyond:.2f} beyond the start (bar {REPORT_S:g}), ",
                end="",
            )
            print(f"{ratio:.1f} x the scoring")
    sys.exit(int(missed and not smallest))


if __name__ == "__main__":
    main()
