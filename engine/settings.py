"""In which settings runs of one method and model differ, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec

from .judged import Judged

_ADDRESS: Final = ("endpoint", "base_url")

Path = tuple[str, ...]


def told_apart(runs: Sequence[Judged]) -> dict[str, str]:
    """Run -> the settings in which it differs from others of its method and model, in a line; "" where there are none.

    Settings of one part stand together behind its name (`marker: seed 3, wrong_box 0.1`). The server's address is left
    out: it differs whenever a server is started anew.
    """
    leaves = {run.manifest.run_id: dict(_leaves((), run.manifest.settings)) for run in runs}
    alike: dict[tuple[str, str], list[dict[Path, str]]] = {}
    for run in runs:
        alike.setdefault((run.manifest.method, run.manifest.model), []).append(leaves[run.manifest.run_id])
    return {
        run.manifest.run_id: _in_words(leaves[run.manifest.run_id], alike[run.manifest.method, run.manifest.model])
        for run in runs
    }


def _in_words(own: dict[Path, str], others: Sequence[dict[Path, str]]) -> str:
    parts: dict[Path, list[str]] = {}
    for path, value in sorted(own.items()):
        if path != _ADDRESS and any(other.get(path) != value for other in others):
            parts.setdefault(path[:-1], []).append(f"{path[-1]} {value}")
    return "; ".join(
        f"{' '.join(above)}: {', '.join(said)}" if above else ", ".join(said) for above, said in parts.items()
    )


def _leaves(path: Path, settings: Any) -> Iterator[tuple[Path, str]]:
    """Every setting as its path and its value: a text as it is, anything else as JSON."""
    if isinstance(settings, dict) and (settings or not path):
        for name, value in settings.items():
            yield from _leaves((*path, str(name)), value)
    else:
        yield path, settings if isinstance(settings, str) else msgspec.json.encode(settings).decode()
