"""Reading results.

``compare``: paired differences against a baseline, by the statistics in ``paired``.  ``summary``: a study in
sentences.  ``cost``: what energy costs.  ``sobol``: which parameters drive a spread.  ``selected``: part of a result by
labels, and drawn parameters in groups.
"""
