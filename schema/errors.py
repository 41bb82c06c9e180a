"""Errors of the package, as one tree.

    AvrError                     every error that this package raises on purpose
    ├── InputError               an input file or a record of one cannot be used
    ├── StoreError               the store is missing, incomplete or was built under different rules
    │   └── LockedError          another process holds the graph
    ├── QueryError               a Cypher or SQL statement is refused or fails
    ├── PlanError                a plan is not valid
    ├── ObserveError             an observation is refused
    ├── RefusedError             an episode refuses a move or an answer
    ├── DecodeError              a model's reply cannot be read
    └── EndpointError            a model server cannot be used
        └── RunStoppedError      the run cannot answer further questions now

Every message is one line and says what to do. The command line prints it and exits with 1. Attributes of an error
name its subject, so that a caller need not parse the message.
"""

from __future__ import annotations

from collections.abc import Iterable


class AvrError(Exception):
    """Root of every error that this package raises on purpose."""


class InputError(AvrError):
    """An input file, or a record of one, cannot be used.

    Attributes:
        file: Path of the file, or "".
        frame: Frame of the record, or "".
        field: Field or argument with the fault, or "".
    """

    def __init__(self, message: str, *, file: str = "", frame: str = "", field: str = "") -> None:
        super().__init__(message)
        self.file = file
        self.frame = frame
        self.field = field


class StoreError(AvrError):
    """The store is missing, incomplete, not writable, or was built under different rules."""


class LockedError(StoreError):
    """Another process holds the graph file; `holder` names that process."""

    def __init__(self, message: str, *, holder: str = "") -> None:
        super().__init__(message)
        self.holder = holder


class QueryError(AvrError):
    """A Cypher or SQL statement is refused by the guard or fails in the engine."""


class PlanError(AvrError):
    """A plan is not valid; `field` is the path of the faulty part, such as `edges[1].source`."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field


class ObserveError(AvrError):
    """An observation is refused: unknown sequence, frame without an image, or angle that is not a finite number."""


class RefusedError(AvrError):
    """An episode refuses a move or an answer; the message is the reason."""


class DecodeError(AvrError):
    """A model's reply does not fit the contract. A prediction stores the message as its reason."""


class EndpointError(AvrError):
    """A model server cannot be reached or breaks the protocol."""


class RunStoppedError(EndpointError):
    """The run ends because no further question can be answered now; a resumed run answers the rest."""


class AvrWarning(UserWarning):
    """A fact that the user should know and that stops nothing, such as questions left out of a run."""


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: the nearest valid name, or else the first valid names.

    Args:
        name: the unknown name.
        valid: all valid names.
    """
    import difflib

    names = sorted(valid)
    near = difflib.get_close_matches(name, names, 1, 0.5)
    if near:
        return f": did you mean {near[0]}?"
    return f": there are {', '.join(names[:_NAMED])}{', ...' if len(names) > _NAMED else ''}" if names else ""


_NAMED = 12
"""Maximum of names that a message lists."""
