"""Adapters that offer the benchmark to other frameworks. Some need additional packages, which the extras install."""
