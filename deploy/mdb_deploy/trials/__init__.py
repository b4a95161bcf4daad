"""A running brain on trial: kills, long runs, and what a witness saw."""
