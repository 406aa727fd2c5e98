"""Whether an estimator follows a gap that grows, and who notices first.

Read ``runs`` (the year), ``detect`` (detectors), ``wear`` (tables, figure, ``main``), ``whole`` (a whole year).
"""
