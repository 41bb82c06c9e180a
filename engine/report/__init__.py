"""Scores, comparisons and reports of runs."""
