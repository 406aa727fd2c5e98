"""Reports: one self-contained HTML file each, and how to cite.

``report``: ``fc.report``.  ``page``: a report as data and as HTML.  ``study``, ``results``, ``paper``: the reports of a
study, of a fit, diagnosis, tuning or explanation, and of the paper.  ``computed``: how results were made, and their
citation.  ``regenerate``: `fastcoil paper`.
"""
