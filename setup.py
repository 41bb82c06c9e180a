"""Finds the packages by rule; everything else is declared in `pyproject.toml`.

The repository's root is the package `jrdb_avr` itself, a prefix that the rules in `pyproject.toml` cannot add.
"""

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

FOLDERS = ("schema", "loaders", "queries", "engine", "agent")


class BuildPackages(build_py):  # type: ignore[misc]
    """Leaves this script out of the package in whose folder it lies."""

    def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
        """Return (package, module, file) of the modules of one package."""
        return [found for found in super().find_package_modules(package, package_dir) if found[1] != "setup"]


setup(
    cmdclass={"build_py": BuildPackages},
    package_dir={"jrdb_avr": "."},
    packages=["jrdb_avr", *(f"jrdb_avr.{name}" for name in find_packages(include=[f"{name}*" for name in FOLDERS]))],
)
