"""Studies: a TOML file in, a folder with one NetCDF file and figures out."""
