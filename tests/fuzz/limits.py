"""How long one call of the program may take: ten seconds of the processor, and five minutes while others have it."""

from __future__ import annotations

import faulthandler
import signal
import sys

LONGEST_S = 10
LONGEST_WAIT_S = 300


def begin():
    """Start the clock of a call anew; one that takes too long ends the process, its stack on the standard error."""
    faulthandler.register(signal.SIGPROF, file=sys.stderr, chain=True)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    faulthandler.dump_traceback_later(LONGEST_WAIT_S, exit=True, file=sys.stderr)


def end():
    """Stop the clock."""
    signal.setitimer(signal.ITIMER_PROF, 0)
    faulthandler.cancel_dump_traceback_later()
