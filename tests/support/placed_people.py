"""People placed in frames."""

from __future__ import annotations


def placed(track):
    return (100 * track + 10, 60, 50, 200)
