"""Figures, reports, exported controllers, explore.

``figures`` show results; ``report`` makes pages of studies, diagnoses and fleets; ``export`` translates
controllers to C, Structured Text, Python, FMU and PLCopen XML; ``explore`` is the page to play with.
"""
