"""Reading results.

``compare``: paired differences against a baseline, by the statistics in ``paired``.  ``summary``: the findings of a
study in sentences, with what energy costs by ``cost``.  ``sobol``: which parameters drive a spread.  ``selected``: part
of a result by labels, and drawn parameters in groups.
"""
