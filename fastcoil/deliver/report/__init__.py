"""Reports: one self-contained HTML file each, and how to cite.

``report``: ``fc.report``.  ``page``: a report as data and as HTML.  ``study``, ``results``: the reports of a study, and
of a fit, diagnosis, tuning or explanation.  ``computed``: how results were made, and their citation.
"""
