"""Random actions of the Gymnasium environment; the package need not be installed."""

import sys
from collections import Counter
from importlib import import_module
from unittest.mock import MagicMock

import pytest

MODULE = "jrdb_avr.engine.integrations.gymnasium"


@pytest.mark.parametrize("count", [1, 2, 4, 7, 1001])
def test_every_index_is_equally_likely(monkeypatch, count):
    monkeypatch.setitem(sys.modules, "gymnasium", MagicMock(Env=object))
    monkeypatch.delitem(sys.modules, MODULE, raising=False)
    index = import_module(MODULE)._index
    monkeypatch.delitem(sys.modules, MODULE)
    # Shares in the middle of equal steps: as many for each index.
    drawn = Counter(index((step + 0.5) / (12 * count), count) for step in range(12 * count))
    assert drawn == dict.fromkeys(range(count), 12)
    # An observation gives index / (count - 1), which is the same index again; the ends belong to the first and last.
    assert [index(i / max(count - 1, 1), count) for i in range(count)] == [*range(count)]
    assert (index(0.0, count), index(1.0, count)) == (0, count - 1)
