"""Fits and diagnosis of measured logs."""
