#!/usr/bin/env bash
# Build the archives that a package index takes, check them, and use each in a fresh environment: tests/package.sh
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

python3 -m venv "$work/tools" && "$work/tools/bin/pip" install --quiet build twine uv
"$work/tools/bin/python" -m build --outdir "$work/dist" . > "$work/build.txt" || { tail -n 30 "$work/build.txt"; exit 1; }
"$work/tools/bin/twine" check --strict "$work"/dist/*

# The source archive holds every file of the repository; the wheel was built from it.
tar -xzf "$work"/dist/*.tar.gz -C "$work" && mv "$work"/jrdb_avr-* "$work/src"
missing=$(comm -23 <(git ls-files | sort) <(cd "$work/src" && find . -type f -printf '%P\n' | sort))
[ -z "$missing" ] || { echo "not in the source archive: $missing"; exit 1; }

# The wheel alone, in an environment that `uvx` makes.
(cd "$work" && tools/bin/uvx --quiet --from dist/*.whl jrdb-avr demo --out demo > demo.txt) || { tail -n 30 "$work/demo.txt"; exit 1; }

# The steps of the Dockerfile, with the unpacked archive as its folder /src.
python3 -m venv "$work/image" && source "$work/image/bin/activate"
sed -n 's/^RUN //p' Dockerfile | sed "s: /src: $work/src:" | bash -eux
(cd "$work" && jrdb-avr --version && jrdb-avr --help > help.txt)

# Tests of each room, from the unpacked archive.
pip install --quiet "$work/src[test]"
cd "$work/src"
pytest -n 0 tests/test_imports.py tests/test_golden.py tests/loaders/test_load_store.py tests/queries/test_store.py \
  tests/agent/methods tests/engine/commands/test_cli.py
