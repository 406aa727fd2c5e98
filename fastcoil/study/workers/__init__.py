"""The workers that run shards, and what happens when one dies."""
