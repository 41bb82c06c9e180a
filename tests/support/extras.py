"""Extras that a test needs: skipped without, unless `REQUIRE_EXTRAS` says that they are to be there."""

import importlib.util
import os

import pytest


def needs(*modules):
    """Skip a file of tests where an extra is missing; its tests import it, which takes up to two seconds."""
    for module in modules:
        found = importlib.util.find_spec(module)
        # Without an origin it is a mere folder of that name.
        if found is None or found.origin is None:
            assert not os.environ.get("REQUIRE_EXTRAS"), f"{module} is not installed"
            pytest.skip(f"{module} is not installed", allow_module_level=True)
