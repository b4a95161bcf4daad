"""Machines of pybullet_data in PyBullet: an arm that reaches for a point, a racing car that drives to a ball."""
