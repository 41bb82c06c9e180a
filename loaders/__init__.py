"""Readers of JRDB files, and the sample world.

The readers fill the annotation tables, the interval tables and the graph of a store.
"""
