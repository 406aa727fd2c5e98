"""The folder of a study: what is committed, merged, opened and extended."""
