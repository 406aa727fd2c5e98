"""Fits and diagnosis of measured logs.

``fit_valve`` and ``fit_coil`` check their arguments, pose a problem (that of a valve in
``valve_problem``), solve it (``least_squares``) and return a ``fit``.  ``diagnose`` puts a
log on a ``grid``, measures it (``measures``), identifies the backlash (``identify``), fits the loop (``fitted_plant``,
``fitted_loop``), judges the ``cause``, describes it hour by hour (``triage``) and returns a ``diagnosis``.  ``swings``
finds swings with their times (``clock``).  ``air_handler`` judges all valves of a unit together.  ``replay`` runs
controllers over a log.
"""
