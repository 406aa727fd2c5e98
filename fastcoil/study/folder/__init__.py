"""The folder of a study: its lock, manifest, shards and results."""
