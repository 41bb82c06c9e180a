"""The leaderboard page: bundles ranked by question set, with intervals and settings, as one file."""

from __future__ import annotations

from jrdb_avr.engine.pages.page import render
from jrdb_avr.engine.pages.report import settings_text
from jrdb_avr.engine.report.leaderboard import Leaderboard


def leaderboard_page(board: Leaderboard) -> str:
    """The page's HTML. Everything in a bundle comes from its submitter, and is shown as text."""
    return render("leaderboard.html", board=board, count=len(board.rows), settings=settings_text)
