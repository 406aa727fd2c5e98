"""The paper's controller, Fig 8: PI, backlash inverse and self-learning rule as scalar functions."""
