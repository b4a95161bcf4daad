"""The Pioneer 2 and its world: in PyBullet, and as a kinematic twin."""
