"""The learners: one contract (``contract.py``), one small file each, chosen by name in the experiment file."""

from typing import Any

from mdb_services.mechanism.learners.adam import Adam
from mdb_services.mechanism.learners.cma import CovarianceAdaptation
from mdb_services.mechanism.learners.committee import Committee
from mdb_services.mechanism.learners.contract import Best, Learner
from mdb_services.mechanism.learners.de import DifferentialEvolution
from mdb_services.mechanism.learners.ga import PlainGA
from mdb_services.mechanism.learners.pbga import PromoterGA
from mdb_services.mechanism.learners.ridge import Ridge
from mdb_services.mechanism.networks.network import Shape
from mdb_services.mechanism.settings import LearnerConfig

__all__ = ["LEARNERS", "Best", "Learner", "make_learner"]

LEARNERS: dict[str, Any] = {
    "pbga": PromoterGA,
    "ga": PlainGA,
    "de": DifferentialEvolution,
    "cma": CovarianceAdaptation,
    "adam": Adam,
    "ridge": Ridge,
}
"""Each learner's class by its name; `settings.LEARNER_CONFIGS` has its settings."""


def make_learner(
    name: str, shape: Shape, settings: LearnerConfig, seed: int, stream_name: str, *, members: int = 1
) -> Learner:
    """Return a learner of networks of a shape, its random numbers from the stream (seed, stream_name).

    Of more than one member it is a committee of such learners, whose network has the units of all.
    Raises KeyError when there is none of that name, ModuleNotFoundError when it needs a package that is missing.
    """
    names = [stream_name] if members == 1 else [f"{stream_name}/member {place}" for place in range(members)]
    made: list[Learner] = [LEARNERS[name](shape, settings, seed, own) for own in names]
    return made[0] if members == 1 else Committee(made, seed, stream_name)
