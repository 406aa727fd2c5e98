"""The parameters of a scenario and their values for a coil like the paper's: names and defaults of the package."""

from fastcoil.model.parameter_table import PARAMETERS

PAPER_LIKE = {name: p.default for name, p in PARAMETERS.items()}
"""C_w, C_c, beta1, beta3 and beta5 are those of one of 8 volumes."""
