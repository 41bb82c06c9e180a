"""A loaded sequence and the frames that can be looked at."""

from __future__ import annotations

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.method import SequenceInfo


def loaded_sequence(store: Store, name: str) -> SequenceInfo:
    """A sequence as loaded, with the frames that have an image.

    Raises StoreError before `load`, ObserveError for a name that is not in the store.
    """
    known = sorted(store.manifest().sequences)
    if name not in known:
        raise ObserveError(f"no sequence {name[:100]!r}; there are: {', '.join(known) or 'none'}")
    row = store.interval("sequence", name).to_pylist()[0]
    frames = store.interval("frames", name)
    with_image = frames.filter(frames["image"])["frame"].to_pylist()
    return SequenceInfo(name, row["fps"], row["frame_count"], tuple(sorted(with_image)))
