"""Extras that a test needs: skipped without, unless `REQUIRE_EXTRAS` says that they are to be there."""

import importlib
import os

import pytest


def needs(module):
    """The module of an extra."""
    return importlib.import_module(module) if os.environ.get("REQUIRE_EXTRAS") else pytest.importorskip(module)
