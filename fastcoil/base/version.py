"""The version of the installed package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Version of fastcoil; ``unknown`` in a source tree that is not installed."""
    try:
        return version("fastcoil")
    except PackageNotFoundError:
        return "unknown"
