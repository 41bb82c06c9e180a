"""Observation of panoramas: crops of panoramas, and annotations that are drawn on panoramas or crops."""
