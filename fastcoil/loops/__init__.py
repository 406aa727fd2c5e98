"""Loop, boundary, simulate, NetCDF."""
