"""Gains and settings of a controller, chosen for the valves and days that it may meet."""
