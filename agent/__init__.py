"""Methods that take the benchmark, and the model server that reads marks."""
