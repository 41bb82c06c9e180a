#!/usr/bin/env bash
# Install the lowest version of every core dependency that pyproject.toml allows, and run the demo and the tests of the
# store with them: tests/lowest_versions.sh
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

python3 -m venv "$work/uv" && "$work/uv/bin/pip" install --quiet uv
python3 -m venv "$work/venv"
source "$work/venv/bin/activate"
# Wheels only: an old sdist may need a compiler that is newer or older than the present one.
"$work/uv/bin/uv" pip install --quiet --only-binary :all: --no-binary jrdb-avr --resolution lowest-direct .
# The test tools at their newest, without an effect on what is installed already.
"$work/uv/bin/uv" pip freeze --exclude-editable | grep -v '^jrdb-avr' > "$work/lowest.txt"
"$work/uv/bin/uv" pip install --quiet --constraint "$work/lowest.txt" pytest pytest-xdist hypothesis
cat "$work/lowest.txt"

(cd "$work" && jrdb-avr demo --out demo > demo.txt) || { tail -n 30 "$work/demo.txt"; exit 1; }
pytest -n 0 tests/test_imports.py tests/queries/test_store.py tests/queries/test_files.py tests/loaders/test_load_store.py \
  tests/engine/commands/test_cli.py
