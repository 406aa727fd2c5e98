"""How far a set-point must move for a log to show the gap of a valve."""
