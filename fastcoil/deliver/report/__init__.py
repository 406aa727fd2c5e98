"""Reports: one self-contained HTML file each, and how to cite.

``page``: a report as data and as HTML, and its sections on how results were made.  ``study``: the report of a study.
``results``: ``fc.report``, and the reports of a fit, diagnosis, tuning or explanation.
"""
