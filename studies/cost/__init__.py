"""Whether backlash raises power, demand and the cost of energy."""
