"""Adapters that offer the benchmark to other frameworks. Some adapters need packages that only extras install."""
