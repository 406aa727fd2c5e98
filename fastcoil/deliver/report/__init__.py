"""Pages for a client: one self-contained HTML file for a study, a diagnosis, a fit, a tuning; and how to cite it."""
