"""Results that must not change: questions, prompts, predictions, scores and report figures have recorded hashes."""

from __future__ import annotations

import golden
import pytest


@pytest.mark.slow
@pytest.mark.parametrize("part", ["sample", "prompts", "scores"])
def test_results_have_the_recorded_hashes(part: str) -> None:
    assert golden.changed_hashes(part) == []
