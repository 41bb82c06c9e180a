"""Sessions on the graph engine Kùzu, and protection against its faults."""
