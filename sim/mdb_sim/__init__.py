"""The robot, its world, the scripted teacher, and the figures of a run."""
