"""What finds the backlash estimate: one file for each estimator, with its memory and its step."""
