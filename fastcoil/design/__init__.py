"""Linearise, limit cycles, explain, tune."""
