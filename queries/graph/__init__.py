"""Sessions on graph files of the engine Kùzu, and protection against faults of the engine."""
