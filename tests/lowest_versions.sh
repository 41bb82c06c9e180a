#!/usr/bin/env bash
# Run the suite with the lowest version of every dependency that pyproject.toml allows: tests/lowest_versions.sh [PYTEST ARGUMENT ...]
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

python3 -m venv "$work/uv" && "$work/uv/bin/pip" install --quiet uv
python3 -m venv "$work/venv"
source "$work/venv/bin/activate"
"$work/uv/bin/uv" pip install --quiet --resolution lowest-direct '.[test]'
"$work/uv/bin/uv" pip list
pytest "$@"
