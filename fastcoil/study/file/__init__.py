"""Reads a study file (TOML) into a validated study."""
