"""Reports: one self-contained HTML file each, and how to cite.

``page``: a report as data and as HTML, and its sections on how results were made.  ``results``: ``fc.report``, and the
reports of a study, fit, diagnosis, tuning or explanation.  ``survey``: that of many valves.
"""
