"""What backlash costs in a year of weather."""
