"""Fitting the valve and the coil to measured data, and replaying a controller on a log."""
