"""The leaderboard page: a ranking of bundles for each question set, with intervals and settings."""

from __future__ import annotations

from jrdb_avr.engine.pages.page import render
from jrdb_avr.engine.pages.report import settings_text
from jrdb_avr.engine.report.bootstrap import LEAST_CLUSTERS
from jrdb_avr.engine.report.formats import without_rough
from jrdb_avr.engine.report.leaderboard import Leaderboard
from jrdb_avr.engine.report.tables import TOO_FEW


def leaderboard_page(board: Leaderboard) -> str:
    """Render the leaderboard page. All content of bundles is untrusted, so it is shown as plain text.

    Args:
        board: The leaderboard.

    Returns:
        The HTML.
    """
    return render(
        "leaderboard.html",
        sets=[[(bundle, without_rough([row])[0]) for bundle, row in entries] for entries in board.sets],
        board=board,
        settings=settings_text,
        too_few=TOO_FEW,
        least=LEAST_CLUSTERS,
    )
