"""Progress of long work, as it is shown to whoever looks."""
