"""Observation of panoramas: crops, and drawings of annotations on them."""
