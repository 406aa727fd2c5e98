"""Studies: from a TOML file to a folder with results and figures."""
