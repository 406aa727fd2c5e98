"""Figures and controls of the page, and how a session keeps them up to date."""
