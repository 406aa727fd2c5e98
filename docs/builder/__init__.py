"""Makes the site out of the pages of the repository."""
