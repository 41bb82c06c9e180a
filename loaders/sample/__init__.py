"""A synthetic JRDB root: a simulated world, the label files that describe it, and its panoramas."""
