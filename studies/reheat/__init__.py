"""Rooms behind reheat coils: which tuning and which remedy, and what a controller sees of the gap through a room."""
