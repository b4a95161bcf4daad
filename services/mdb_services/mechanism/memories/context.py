"""Change of context, say of the teacher, detected from the prequential error; what it does to the memory.

The mechanism's literature switches the short-term memory to its temporal setting while the context changes and
back to relevance afterwards; how a change is noticed is ours: a cumulative sum of the errors beyond the usual
one (Page, 1954), over errors that are cut off, so that one odd pair is not a change. A teacher who errs makes some
pairs odd for ever: what counts as odd, and how much of it as a change, grows with the usual error.

A second sum looks for small errors that have become many times what they were and stay so, as when the robot's own
body has changed a little: it is over the logarithms, so that no single error says much, however large (ours).
"""

import math
from dataclasses import dataclass

import numpy as np

from mdb_services.mechanism.memories.stm import MemoryConfig
from mdb_services.mechanism.settings import at_least, positive

UNUSUAL = 2.5
"""An error speaks for a change when it is this many times the usual one, and `margin` more."""
CHANGED = 0.75
"""The mean error to be expected after a change, each error cut off: half way to it speaks for one in any case."""
NOISE = 5.0
"""The threshold is so much higher, as a share of itself, for each unit of the usual error."""
SMALL = 1e-3
"""Errors that are smaller than this are alike."""
RISEN = 1.0
"""The logarithm of an error speaks for a rise by what it is above the usual one, and this."""
MOST_RISEN = 3.0
"""No error counts as further above or below the usual one: it is twenty times that, or a twentieth."""
RISEN_PAIRS = 150
"""Pairs until it is known which logarithm is usual."""
USUAL_PAIRS = 80
"""Pairs in the running mean of a known context, which is to tell a teacher's errors from chance."""


@dataclass(frozen=True, kw_only=True)
class ContextConfig:
    """When a context counts as known, as left, and what happens then. Errors are in the models' scaled units."""

    enabled: bool = True
    known_error: float = 0.05
    """A context is known when the usual error is below this: only a known one can be left."""
    known_after: int = 150
    """After so many pairs it is known whatever the error is: that of a teacher who errs never falls so low."""
    known_pairs: int = 20
    """Pairs at least until a new context is known; the usual error is their running mean."""
    cut_off: float = 1.0
    """The error of one pair counts at most as this."""
    margin: float = 0.1
    """Error beyond two and a half times the usual one that is not yet evidence of a change."""
    threshold: float = 1.5
    """Sum of the evidence that means a change, where the usual error is 0: more than `cut_off`, hence more than one
    pair."""
    rise: float | None = None
    """Sum of the evidence that means a change where all errors have risen, each at most 2 (`MOST_RISEN`, `RISEN`).
    None: that is not looked for."""
    forget: bool = True
    """Whether the pairs from before the change are dropped at once; otherwise they leave first in, first out."""
    recency: float = 1.0
    """Kt of the temporal setting, while a new context is not known yet."""
    distance: float = 0.0
    """Kd of the temporal setting."""

    def __post_init__(self) -> None:
        positive(self, "known_error", "cut_off", "margin", "threshold")
        if self.rise is not None and not MOST_RISEN - RISEN < self.rise < np.inf:
            raise ValueError(f"rise is {self.rise}; expected more than {MOST_RISEN - RISEN:g}: one pair is no change")
        if self.threshold <= self.cut_off:
            raise ValueError(
                f"threshold is {self.threshold}; expected more than cut_off = {self.cut_off}: one pair is no change"
            )
        at_least(self, known_pairs=1, known_after=1)
        MemoryConfig(recency=self.recency, distance=self.distance)

    @property
    def temporal(self) -> MemoryConfig:
        """Return the label's weights while a new context is not known."""
        return MemoryConfig(recency=self.recency, distance=self.distance)


class ContextDetector:
    """Follows the errors of one model on pairs it has not learnt yet, one version of the memory after the other."""

    def __init__(self, config: ContextConfig) -> None:
        self.config = config
        self.begin(0, changed=False)

    def begin(self, version: int, *, changed: bool = True, known: bool = False) -> None:
        """Begin a context at a version; `known`: one that came back with a model that fits."""
        self.first = version
        """The version in which the first pair of this context, as far as is known, entered."""
        self.changing = changed and not known
        """Whether the temporal setting is in force: after a change, until the new context is known."""
        self.known = known
        self.usual = 0.0
        """Running mean of the errors, each cut off."""
        self._pairs = self.config.known_pairs if known else 0
        self._lasted = 0
        self._evidence = 0.0
        self._before = 0.0
        """The usual error before what may be a change: from then on it is of another context."""
        self.suspected: int | None = None
        """The version of the first pair of what may be another context; None while nothing speaks for a change."""
        self._level = self._rise = 0.0
        """The usual logarithm of the errors, and how much speaks for a rise above it ..."""
        self._levelled = 0
        self._risen_from = 0
        """... since this version."""

    @property
    def settled(self) -> bool:
        """Whether the context has lasted for `known_pairs`: one that has just begun is not left on a suspicion."""
        return self._lasted >= self.config.known_pairs

    def step(self, error: float, version: int) -> bool:
        """Take the error on the pair that entered at `version`; return whether the context has changed.

        Then `first` is the version from which on pairs are of the new context.
        """
        if not self.config.enabled:
            return False
        config, error = self.config, min(error, self.config.cut_off)
        if self.known:
            if self.suspected is None:
                self._before = self.usual
            unusual = min(UNUSUAL * self._before + config.margin, max((self._before + CHANGED) / 2, self._before))
            self._evidence = max(0.0, self._evidence + error - unusual)
            if self._evidence == 0:
                self.suspected = None
            elif self.suspected is None:
                self.suspected = version
            if self.suspected is not None and self._evidence > config.threshold * (1 + NOISE * self._before):
                # what was recalled a moment ago does not fit after all: the context began where that one did
                self.begin(self.suspected if self.settled else self.first)
                return True
        if config.rise is not None and self._has_risen(error, version, config.rise):
            self.begin(self._risen_from)
            return True
        self._pairs, self._lasted = self._pairs + 1, self._lasted + 1
        window = max(USUAL_PAIRS, config.known_pairs) if self.known else config.known_pairs
        self.usual += (error - self.usual) / min(self._pairs, window)
        enough = config.known_pairs if self.usual < config.known_error else config.known_after
        if self._pairs >= enough:
            self.known, self.changing = True, False
        return False

    def _has_risen(self, error: float, version: int, most: float) -> bool:
        """Follow the errors' logarithms; return whether they have become and stayed much larger than they were."""
        above = math.log(error + SMALL) - self._level
        if self._levelled >= RISEN_PAIRS:
            if self._rise == 0:
                self._risen_from = version
            self._rise = max(0.0, self._rise + min(max(above, -MOST_RISEN), MOST_RISEN) - RISEN)
            if self._rise > most:
                return True
        self._levelled += 1
        self._level += above / min(self._levelled, USUAL_PAIRS if self._levelled > RISEN_PAIRS else RISEN_PAIRS)
        return False
