"""What a log of a whole air handler shows: valves that leak or stick, sensors, set-points and loops that hunt."""
