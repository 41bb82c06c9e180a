"""Adapters that offer the benchmark to other frameworks. Some of them need packages of an extra of this package."""
