"""What `mdb teach` shows."""
