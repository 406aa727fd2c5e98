"""Results as tables: CSV, Parquet and LaTeX, and numbers as people write them."""
