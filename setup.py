"""Finds the packages by rule; everything else is declared in `pyproject.toml`.

The repository's root is the package `jrdb_avr` itself, a prefix that the rules in `pyproject.toml` cannot add.
"""

from setuptools import find_packages, setup

FOLDERS = ("schema", "loaders", "queries", "engine", "agent")

setup(
    package_dir={"jrdb_avr": "."},
    packages=["jrdb_avr", *(f"jrdb_avr.{name}" for name in find_packages(include=[f"{name}*" for name in FOLDERS]))],
)
