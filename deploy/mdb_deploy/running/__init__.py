"""A run of processes: begun, watched, shown."""
