"""Every learner that an experiment file can name keeps the `Learner` contract."""

import subprocess
import sys

import pytest

from mdb_services.mechanism.learners import LEARNERS, make_learner
from mdb_services.mechanism.settings import LEARNER_CONFIGS
from tests.conformance.learner_conformance import SMALL, LearnerConformance


class LearnerOf(LearnerConformance):
    """The suite for a learner, or a committee of such, with default settings."""

    learner = ""
    members = 1

    def make(self, shape, seed=5, name="evolver/communication"):
        if self.learner == "cma":
            pytest.importorskip("cmaes")
        settings = LEARNER_CONFIGS[self.learner]()
        return make_learner(self.learner, shape, settings, seed, name, members=self.members)


class NamedLearner(LearnerOf):
    """The suite for a single learner."""


class TestPromoterGA(NamedLearner):
    learner = "pbga"


class TestPlainGA(NamedLearner):
    learner = "ga"


class TestDifferentialEvolution(NamedLearner):
    learner = "de"


class TestCovarianceAdaptation(NamedLearner):
    learner = "cma"


class TestAdam(NamedLearner):
    learner = "adam"


class TestRidge(NamedLearner):
    learner = "ridge"


class CommitteeOf(LearnerOf):
    """The suite for a committee of three."""

    members = 3


class TestCommitteeOfPromoterGAs(CommitteeOf):
    learner = "pbga"


class TestCommitteeOfAdams(CommitteeOf):
    learner = "adam"


class TestCommitteeOfRidges(CommitteeOf):
    learner = "ridge"


def test_every_learner_has_settings_and_runs_the_suite():
    assert LEARNERS.keys() == LEARNER_CONFIGS.keys() == {suite.learner for suite in NamedLearner.__subclasses__()}


@pytest.mark.parametrize("learner", LEARNERS)
def test_the_state_of_another_learner_is_refused(learner):
    pytest.importorskip("cmaes")
    made = {name: make_learner(name, SMALL, LEARNER_CONFIGS[name](), 5, "evolver/object") for name in LEARNERS}
    for name, other in made.items():
        if (learner, name) not in {("pbga", "ga"), (name, learner)}:  # every plain population is a promoter one
            with pytest.raises(ValueError, match="start afresh"):
                made[learner].restore(other.state())


def test_without_cmaes_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "cmaes", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install .*\[learners\]"):
        make_learner("cma", SMALL, LEARNER_CONFIGS["cma"](), 5, "evolver/object")


def test_reading_an_experiment_file_imports_neither_numba_nor_llvm_nor_cmaes():
    read = "import sys, mdb_services.experiment.brain; print(sys.modules.keys() & {'numba', 'llvmlite', 'cmaes'})"
    done = subprocess.run([sys.executable, "-c", read], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
