"""What holds of the paper, and where."""
