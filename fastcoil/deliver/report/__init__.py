"""Reports: one self-contained HTML file each, and how to cite.

``page``: a report as data and as HTML, and the sections on methods and versions.  ``results``: ``fc.report``, and the
reports of a study, diagnosis, tuning or explanation.  ``survey``: the report of many valves.
"""
