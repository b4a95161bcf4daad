"""Processes of a run: started, watched, shown."""
