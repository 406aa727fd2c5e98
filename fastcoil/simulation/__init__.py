"""Loops, scenarios and days as labelled Datasets: what ``fc.simulate`` is made of."""
