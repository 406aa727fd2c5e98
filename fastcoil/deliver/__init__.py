"""Figures, tables, reports, exported controllers, explore."""
