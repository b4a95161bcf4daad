"""The teacher: wants the robot to go to the light, says which way, and judges what came of it. Make it yours."""

import math

TURNS_RAD = (-1.33, -0.67, 0.0, 0.67, 1.33)  # what he can ask for: to turn so far to the left, and go on


class Teacher:
    """Asks for the turn that best faces the light, and praises what faces it."""

    commands = ("right", "half right", "ahead", "half left", "left")
    order = (0, 1, 2, 3, 4)  # they are in an order, from the right to the left
    needs = ("distance_m", "angle_rad")  # the numbers of the scene that he looks at

    def want(self, scene):
        """Return the command that he wants in a scene, counted from 0; None: none."""
        return min(range(len(TURNS_RAD)), key=lambda command: abs(scene["angle_rad"] - TURNS_RAD[command]))

    def rate(self, before, after, event):
        """Return how good what happened is, -1 to 1, when nothing was wanted: whether it faces the light now."""
        return 1.0 if event == "reached" else 1.0 - 2.0 * abs(after["angle_rad"]) / math.pi

    def judge(self, before, after, event, wanted):
        """Return how well what happened is what was wanted: by how far the light moved to the right, as he saw it."""
        if event == "reached":
            return 1.0
        turned_rad = math.remainder(before["angle_rad"] - after["angle_rad"], math.tau)
        return max(-1.0, 1.0 - abs(turned_rad - TURNS_RAD[wanted]) / 0.8)

    def expected(self, wanted, action):
        """Return the judgement of an action that does as it is told, for figures; None: that depends on where."""
        return None
