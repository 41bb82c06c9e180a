"""How many examples Hypothesis tries: a few in the gate, twenty times as many in `HYPOTHESIS_PROFILE=deep pytest`."""

import os

DEEP = os.environ.get("HYPOTHESIS_PROFILE") == "deep"


def examples(gate):
    """For `settings(max_examples=...)` of tests whose examples are dear."""
    return 20 * gate if DEEP else gate
