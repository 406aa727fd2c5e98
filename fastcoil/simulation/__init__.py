"""Loops, scenarios and days as labelled Datasets: the parts of ``fc.simulate``."""
