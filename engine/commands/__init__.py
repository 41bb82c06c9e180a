"""One module per command: a thin skin over the library."""
