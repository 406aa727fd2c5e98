"""A year of weather with the real operation of an air handler, made day by day."""
