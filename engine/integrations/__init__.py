"""The benchmark in other frameworks: one module each, imported only with its own extra installed."""
