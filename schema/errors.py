"""The error tree.

    AvrError                     everything this package raises on purpose
    ├── InputError               a file or record from outside cannot be used
    ├── StoreError               the store is missing, incomplete or of other rules
    │   └── LockedError          another process holds the graph
    ├── QueryError               a Cypher or SQL statement is refused or fails
    ├── PlanError                a graph plan is not valid
    ├── ObserveError             an observation is refused
    ├── RefusedError             an episode does not carry out a move
    ├── DecodeError              a model's reply cannot be read
    └── EndpointError            a model server cannot be used
        └── RunStoppedError      no further question of the run can be answered now

Every message is one line and says what to do; the command line prints it and exits with 1. Each error carries
the thing it is about, so that a caller need not parse the message.
"""

from __future__ import annotations

from collections.abc import Iterable


class AvrError(Exception):
    """Root of every error that this package raises on purpose."""


class InputError(AvrError):
    """A file, or a record of one, cannot be used; names where it stands."""

    def __init__(self, message: str, *, file: str = "", frame: str = "", field: str = "") -> None:
        super().__init__(message)
        self.file = file
        self.frame = frame
        self.field = field


class StoreError(AvrError):
    """The store is missing, incomplete, not writable, or was built under other rules."""


class LockedError(StoreError):
    """Another process holds the graph file; `holder` says which."""

    def __init__(self, message: str, *, holder: str = "") -> None:
        super().__init__(message)
        self.holder = holder


class QueryError(AvrError):
    """A Cypher or SQL statement is refused by the guard or fails in the engine."""


class PlanError(AvrError):
    """A graph plan is not valid; `field` is the path of the offending part, as in `edges[1].source`."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field


class ObserveError(AvrError):
    """An observation is refused: unknown sequence, frame without an image, angle that is no number."""


class RefusedError(AvrError):
    """A move of an episode is not carried out, or an answer not taken; the message is the reason."""


class DecodeError(AvrError):
    """A model's reply does not fit the contract; the reason is what a prediction row stores."""


class EndpointError(AvrError):
    """A model server cannot be reached, or does not keep the protocol."""


class RunStoppedError(EndpointError):
    """No further question can be answered now: the run ends, and is resumed later. No question is spent on it."""


class AvrWarning(UserWarning):
    """Something that a person should know and that ends nothing, such as questions left out of a run."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: the nearest known one, or else what there is."""
    import difflib

    names = sorted(known)
    near = difflib.get_close_matches(name, names, 1, 0.5)
    if near:
        return f": did you mean {near[0]}?"
    return f": there are {', '.join(names[:_NAMED])}{', ...' if len(names) > _NAMED else ''}" if names else ""


_NAMED = 12
"""Names that a message lists at most."""
