"""Reading results: paired comparisons, Sobol' indices, summaries."""
