"""What results say: paired comparisons, Sobol' indices, summaries in words."""
