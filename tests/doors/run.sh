#!/usr/bin/env bash
# Test doors to other tools, each in an environment of its own, with the releases of DOOR.txt or with the newest ones:
# tests/doors/run.sh [pinned|newest] DOOR...
set -euo pipefail
cd "$(dirname "$0")/../.."
releases=$1
shift

integrations=tests/engine/integrations
declare -A tests=(
  [clients]="tests/test_imports.py tests/queries/test_cluster.py $integrations/test_inspect_ai.py $integrations/test_mcp.py
    $integrations/test_gymnasium.py $integrations/test_huggingface.py $integrations/test_integrations_docs.py"
  [rl]="$integrations/test_rl.py $integrations/test_trl.py"
  [openenv]=$integrations/test_openenv.py
)
declare -A extras=([clients]='[inspect,mcp,gym,ray,test]')
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for door in "$@"; do
  # The newest torch may have no build for CPUs alone, so it stays pinned.
  if [ "$releases" = newest ]; then unpin='/^torch=/!s/==.*//'; else unpin=''; fi
  sed "$unpin" "tests/doors/$door.txt" > "$work/$door.txt"
  python3 -m venv "$work/$door"
  "$work/$door/bin/pip" install --quiet ".${extras[$door]-}" -r "$work/$door.txt" pytest pytest-xdist hypothesis
  "$work/$door/bin/pip" freeze | grep -ixf <(sed -n 's/^\([a-z].*\)==.*/\1==.*/p' "tests/doors/$door.txt")
  # shellcheck disable=SC2086  # the files are separate arguments
  REQUIRE_EXTRAS=1 "$work/$door/bin/python" -m pytest -m "" -n 0 ${tests[$door]}
done
