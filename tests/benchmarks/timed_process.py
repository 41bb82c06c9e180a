"""The process of a world model that notes what each read and each transaction takes, by the clock and of the processor,
for bench_world.py.
"""

import json
import sys
import time
from pathlib import Path

from jrdb_avr.queries.beliefs import process as world_process
from jrdb_avr.queries.beliefs.tables import WorldTables

TIMES = {"write": [], "read": []}


def timed(kind, call):
    def noted(*arguments):
        began = time.perf_counter(), time.process_time()
        try:
            return call(*arguments)
        finally:
            TIMES[kind].append((time.perf_counter() - began[0], time.process_time() - began[1]))

    return noted


if __name__ == "__main__":
    WorldTables.query = timed("read", WorldTables.query)
    WorldTables._write = timed("write", WorldTables._write)
    world_process.main()
    Path(f"{sys.argv[1]}.times").write_text(json.dumps(TIMES))
