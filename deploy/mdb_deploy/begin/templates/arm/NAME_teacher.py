"""The teacher: wants the hand at the point. He commands nothing, he praises and punishes only. Make it yours."""

import math

STEP_M = 0.1  # what is won in one action that is praised fully


class Teacher:
    """Praises what brings the hand nearer to the point, and punishes what takes it away."""

    commands = ("go on", "stop")  # what he could ask for: a note each
    order = (0, 1)
    needs = ("hand_x_m", "hand_y_m", "point_x_m", "point_y_m")  # the numbers of the scene that he looks at

    def want(self, scene):
        """Return the command that he wants in a scene, counted from 0; None: none, he only judges."""
        return None

    def rate(self, before, after, event):
        """Return how good what happened between two scenes is, -1 to 1: what was won of the way."""
        won_m = self._away_m(before) - self._away_m(after)
        return 1.0 if event == "reached" else max(-1.0, min(1.0, won_m / STEP_M))

    def judge(self, before, after, event, wanted):
        """Return how well what happened is what was wanted; here nothing ever is."""
        return self.rate(before, after, event)

    def expected(self, wanted, action):
        """Return the judgement of an action that does as it is told, for figures; None: that depends on where."""
        return None

    def _away_m(self, scene):
        return math.dist((scene["hand_x_m"], scene["hand_y_m"]), (scene["point_x_m"], scene["point_y_m"]))
