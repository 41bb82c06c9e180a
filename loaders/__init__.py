"""Readers that turn JRDB files into annotation tables, intervals and the graph of a store, and the sample world."""
