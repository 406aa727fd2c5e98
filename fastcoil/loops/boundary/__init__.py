"""The series that act on the loop from outside: entering air and water, set-point; made, logged or from weather.

Read ``series`` (what a user may give), ``samples`` (a Dataset of all days, makers of days, digests) and ``record``
(``Boundary``) first.  ``days`` and ``weather`` make boundaries; ``air_handler`` stands in for a
building; ``weather_files`` reads files.
"""

from fastcoil.loops.boundary.record import Boundary as Boundary
