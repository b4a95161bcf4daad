"""Runs of before: replayed, rescued, and what their long-term memory holds."""
