"""JRDB files to annotation tables, time-stamped intervals and the graph; the sample world."""
