"""The series that act on the loop from outside: entering air and water, set-point; made, logged or from weather."""

from fastcoil.loops.boundary.record import Boundary as Boundary
