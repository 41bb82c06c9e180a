#!/usr/bin/env bash
# Write the figures of the docs that come from commands: tests/figures.sh [ROOT]
# The gate compares these figures. With ROOT, a copy of JRDB, and on a quiet machine, print the figures of docs/figures.md too.
set -euo pipefail
cd "$(dirname "$0")/.."

REWRITE_DOCS=1 pytest -n 0 tests/test_docs.py -k tour
for page in api commands tables; do
  python -m jrdb_avr.engine.commands.page "$page" > "docs/$page.md"
done
python docs/draw_definitions.py > docs/definitions.svg

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python tests/benchmarks/bench_usage.py --out "$work/usage" > "$work/usage.toml"
mv "$work/usage.toml" engine/run/usage.toml
[ $# = 0 ] && exit

time jrdb-avr load "$1" --store "$work/store"
time jrdb-avr generate --store "$work/store" --profile paper --workers 1
time jrdb-avr validate --store "$work/store" --replay
for benchmark in load generate lite observe score report calls world; do
  time python "tests/benchmarks/bench_$benchmark.py"
done
python tests/benchmarks/bench_agent.py "$1"
