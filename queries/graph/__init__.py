"""Sessions on the graph engine, and the guards against its faults."""
