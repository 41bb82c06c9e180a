#!/usr/bin/env bash
# Test doors to other tools, each in an environment of its own, with the releases of DOOR.txt or with the newest ones:
# tests/doors/run.sh [pinned|newest] DOOR...
set -euo pipefail
cd "$(dirname "$0")/../.."
releases=$1
shift

declare -A tests=(
  [rl]="tests/engine/integrations/test_rl.py tests/engine/integrations/test_trl.py"
  [openenv]=tests/engine/integrations/test_openenv.py
)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for door in "$@"; do
  # The newest torch may have no build for CPUs alone, so it stays pinned.
  if [ "$releases" = newest ]; then unpin='/^torch=/!s/==.*//'; else unpin=''; fi
  sed "$unpin" "tests/doors/$door.txt" > "$work/$door.txt"
  python3 -m venv "$work/$door"
  "$work/$door/bin/pip" install --quiet . -r "$work/$door.txt" pytest pytest-xdist hypothesis
  "$work/$door/bin/pip" freeze | grep -ixf <(sed -n 's/^\([a-z].*\)==.*/\1==.*/p' "tests/doors/$door.txt")
  # shellcheck disable=SC2086  # the files are separate arguments
  REQUIRE_EXTRAS=1 "$work/$door/bin/python" -m pytest -m "" -n 0 ${tests[$door]}
done
