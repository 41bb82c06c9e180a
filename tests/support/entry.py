"""The command line in the tests' own process, for tests that are not about the process."""

import io
import sys

import pytest

from jrdb_avr.engine.cli import main


def run(*arguments):
    """The command's entry point: exit code, stdout, stderr."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["jrdb-avr", *map(str, arguments)])
        patch.setattr(sys, "stdout", out)
        patch.setattr(sys, "stderr", err)
        try:
            main()
            code = 0
        except SystemExit as exit_:
            code = exit_.code
    return code, *(stream.buffer.getvalue().decode() for stream in (out, err))
