"""Errors of the package, as one tree.

    AvrError                     every error that this package raises on purpose
    ├── InputError               an argument, an input file or a record of a file cannot be used
    ├── StoreError               the store is missing, incomplete or was built under different rules
    │   └── LockedError          another process holds the graph
    ├── QueryError               a Cypher or SQL statement is refused or fails
    ├── PlanError                a plan is not valid
    ├── ObserveError             an observation is refused
    ├── RefusedError             an episode refuses a move or an answer
    ├── DecodeError              a model's reply cannot be read
    └── EndpointError            a model server cannot be used
        ├── FilteredError        a content filter of the server refuses a prompt
        └── RunStoppedError      the run cannot answer further questions now

Every message is one line and says what the user can do. The command line prints the message and exits with status 1.
Errors have attributes, such as the file and the field, so that callers need not parse messages.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from traceback import walk_stack


class AvrError(Exception):
    """Root of every error that this package raises on purpose."""


class InputError(AvrError):
    """An argument, an input file, or a record of a file cannot be used.

    Attributes:
        file: Path of the file, "" if the error is not about a file.
        frame: Frame of the faulty record, "" if the error is not about a frame.
        field: Name of the faulty field or argument, "" if it is unknown.
    """

    def __init__(self, message: str, *, file: str = "", frame: str = "", field: str = "") -> None:
        super().__init__(message)
        self.file = file
        self.frame = frame
        self.field = field


class StoreError(AvrError):
    """The store is missing, incomplete, not writable, or was built under different rules."""


class LockedError(StoreError):
    """The store or its graph is in use by another process or by this process. `holder` describes the process."""

    def __init__(self, message: str, *, holder: str = "") -> None:
        super().__init__(message)
        self.holder = holder


class QueryError(AvrError):
    """A Cypher or SQL statement is refused by the guard or fails in the engine."""


class PlanError(AvrError):
    """A plan is not valid. `field` is the path of the faulty field in the plan, such as `edges[1].source`."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field


class ObserveError(AvrError):
    """An observation is refused: the sequence is unknown, the frame has no image, or the angle is not finite."""


class RefusedError(AvrError):
    """An episode refuses a move or an answer. The message gives the reason."""


class DecodeError(AvrError):
    """A model's reply does not have the requested form.

    The prediction of the question stores the message of this error as the reason for the missing answer.
    """


class EndpointError(AvrError):
    """A model server cannot be reached, or does not follow the protocol."""


class FilteredError(EndpointError):
    """A content filter of the server refuses a prompt. The question ends as invalid, and is not asked again."""


class RunStoppedError(EndpointError):
    """The run ends because no further question can be answered now. A resumed run answers the remaining questions."""


class AvrWarning(UserWarning):
    """Warning about something that does not stop the work, such as questions that were left out of a run."""


def warn(message: str) -> None:
    """Issue an AvrWarning that points at the code that called this package."""
    inside = [str(frame.f_globals.get("__name__")).startswith("jrdb_avr.") for frame, _ in walk_stack(sys._getframe())]
    warnings.warn(message, AvrWarning, stacklevel=len(inside) + 1 - inside[::-1].index(True))


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """Suggest valid names for an unknown name.

    Args:
        name: Unknown name.
        valid: All valid names.

    Returns:
        A text to append to an error message. The text has the most similar valid name. If all valid names differ too
        much from the unknown name, the text has up to 12 valid names in alphabetical order. The text is "" if there
        are no valid names.
    """
    import difflib

    if near := difflib.get_close_matches(name, names := sorted(valid), 1, 0.5):
        return f": did you mean {near[0]}?"
    return f": there are {', '.join(names[:12])}{', ...' if len(names) > 12 else ''}" if names else ""
