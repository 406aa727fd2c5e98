"""What acts on the loop from outside: entering air and water, set-point; from functions, logs and weather."""

from fastcoil.boundary.record import Boundary as Boundary
