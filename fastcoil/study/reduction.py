"""Stub."""

from typing import Any

Reduction = Any
