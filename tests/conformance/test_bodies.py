"""Every body keeps the contract, both Pioneers their own rules, and a body is found by its name."""

import builtins
import subprocess
import sys
from pathlib import Path

import pytest

from mdb_sim.bodies.finding import MEMBERS, find, make_body, spec_of
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.body import BodyError
from tests.conformance.body_conformance import BodyConformance
from tests.conformance.pioneer_conformance import PioneerConformance
from tests.conformance.small_bodies import Crane, Turntable

SETTINGS = {"swapped": True, "turn_share": 0.8, "left_wheel": 0.9, "blind": [3, 4]}
WRONG_SETTINGS = {"swapped": True, "turn_share": -1.0}


class TestKinematicBody(BodyConformance):
    actions = 150
    settings, wrong_settings = SETTINGS, WRONG_SETTINGS

    def make(self):
        return make_body("kinematic", {})


class TestPyBulletBody(BodyConformance):
    actions = 40
    settings, wrong_settings = SETTINGS, WRONG_SETTINGS

    def make(self):
        pytest.importorskip("pybullet")
        return make_body("pybullet", {})


class TestOtherPioneer(BodyConformance):
    options = {"advance_m": 0.5, "arena_m": 5.0, "sonar_dropout": 0.3, "lost_readings": 1}  # noqa: RUF012
    settings, wrong_settings = {"object_x_m": 1.0}, {"turn_share": 0.5, "object_y_m": 99.0}

    def make(self):
        return make_body("kinematic", self.options)


class TestPioneerBesideAWall(BodyConformance):
    options = {"start": "wall"}  # noqa: RUF012
    settings, wrong_settings = {"right_wheel": 1.2}, {"left_wheel": 0.5, "blind": [16]}

    def make(self):
        return make_body("kinematic", self.options)


class TestCrane(BodyConformance):
    options = {"load_kg": 2.0}  # noqa: RUF012
    settings, wrong_settings = {"load_kg": 3.0}, {"load_kg": -1.0}
    random = False

    def make(self):
        return Crane(**self.options)


class TestTurntable(BodyConformance):
    repeats = False

    def make(self):
        return Turntable()


class TestCartPole(BodyConformance):
    options = {"env": "CartPole-v1", "names": ["x", "x_speed", "angle", "angle_speed"]}  # noqa: RUF012

    def make(self):
        pytest.importorskip("gymnasium")
        return make_body("gymnasium", self.options)


class TestPendulum(BodyConformance):
    actions = 120
    options = {"env": "Pendulum-v1", "actuators": ["torque"], "repeat": 2}  # noqa: RUF012

    def make(self):
        pytest.importorskip("gymnasium")
        return make_body("gymnasium", self.options)


class TestRates(BodyConformance):
    actions = 120
    options = {"env": "Pendulum-v1", "names": ["cos", "sin", "speed"], "rates": ["sin", "speed"], "repeat": 2}  # noqa: RUF012

    def make(self):
        pytest.importorskip("gymnasium")
        return make_body("gymnasium", self.options)


class TestFrozenLake(BodyConformance):
    options = {"env": "FrozenLake-v1"}  # noqa: RUF012
    random = False

    def make(self):
        pytest.importorskip("gymnasium")
        return make_body("gymnasium", self.options)


class TestSeveralSpaces(BodyConformance):
    """A Dict of observations, one of them endless, and actions of which some are whole numbers."""

    def make(self):
        pytest.importorskip("gymnasium")
        from tests.deploy import spaces

        spaces.register()
        return make_body("gymnasium", {"env": "SeeStacked-v0", "grid": 6})


class TestMixedActions(BodyConformance):
    def make(self):
        pytest.importorskip("gymnasium")
        from tests.deploy import spaces

        spaces.register()
        return make_body("gymnasium", {"env": "DoMixed-v0"})


class TestArm(BodyConformance):
    options = {"turn_rad": 0.3}  # noqa: RUF012

    def make(self):
        pytest.importorskip("pybullet")
        return make_body("iiwa", self.options)


class TestCar(BodyConformance):
    actions = 40
    options = {"place_max_m": 1.0}  # noqa: RUF012

    def make(self):
        pytest.importorskip("pybullet")
        return make_body("racecar", self.options)


class TestKinematicPioneer(PioneerConformance):
    def make(self, **options):
        return make_body("kinematic", options)


class TestPyBulletPioneer(PioneerConformance):
    iterations = 60

    def make(self, **options):
        pytest.importorskip("pybullet")
        return make_body("pybullet", options)


# ---- a body is found by its name ----


def test_a_body_of_another_make_is_found_by_module_and_factory():
    robot = make_body("mdb_sim.bodies.pioneer.twin:KinematicRobot", {"advance_m": 0.1})
    assert isinstance(robot, KinematicRobot)
    assert robot.config.advance_m == 0.1


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("rover", "no body named 'rover'; expected 'kinematic', 'pybullet', .* or 'package.module:Factory'"),
        (":Robot", "no body named ':Robot'; expected"),
        ("rover:", "no body named 'rover:'; expected"),
        ("no.such.module:Robot", "importing no.such.module failed: No module named 'no'; install it, put it beside"),
        ("mdb_sim.bodies.pioneer.twin:Rover", "no callable 'Rover'; correct the name after the colon"),
        ("mdb_sim.bodies.pioneer.arena:TRAIL", "no callable 'TRAIL'"),
        ("mdb_sim.body:Sensor", r"its factory does not take the options \{\}"),
        ("builtins:object", "gave a object without spec, reset, act, halt, scene, state, restore, close"),
    ],
)
def test_a_body_that_cannot_be_had_says_why(body, says):
    with pytest.raises(BodyError, match=says):
        make_body(body, {})


def test_options_that_a_factory_does_not_take_are_named():
    with pytest.raises(BodyError, match=r"does not take the options \{'wheels': 3\}.*unexpected keyword"):
        make_body("tests.conformance.small_bodies:Crane", {"wheels": 3})
    with pytest.raises(BodyError, match=r"robot\.options: .*wheels"):
        make_body("kinematic", {"wheels": 3})


def test_without_pybullet_the_error_names_the_extra(monkeypatch):
    real_import = builtins.__import__

    def without_pybullet(name, *args, **kwargs):
        if name == "pybullet":
            raise ModuleNotFoundError("No module named 'pybullet'", name="pybullet")
        return real_import(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "mdb_sim.bodies.pioneer.physics", raising=False)
    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    monkeypatch.setattr(builtins, "__import__", without_pybullet)
    with pytest.raises(BodyError, match=r"needs the package pybullet, .* run `pip install '.*\[pybullet\]'`"):
        make_body("pybullet", {})
    assert make_body("kinematic", {}), "the twin needs none"


def test_only_pybullet_has_a_window():
    with pytest.raises(BodyError, match="body='kinematic' has no window"):
        make_body("kinematic", {}, gui=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems need no DISPLAY")
def test_a_window_without_a_display_is_refused_and_the_process_lives_on(monkeypatch):
    pytest.importorskip("pybullet")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(BodyError, match="DISPLAY is not set"):
        make_body("pybullet", {}, gui=True)


def test_what_a_body_has_is_told_by_its_factory_or_by_a_body_that_is_closed_again():
    assert spec_of("kinematic", {"attention_m": 1.0}) == KinematicRobot.spec_of(attention_m=1.0)
    assert spec_of("tests.conformance.small_bodies:Turntable", {}) == Turntable.spec
    closed = []

    class Watched(Turntable):
        def close(self):
            closed.append(self)

    module = type(sys)("watched_bodies")
    module.Watched = Watched
    sys.modules["watched_bodies"] = module
    try:
        assert spec_of("watched_bodies:Watched", {}) == Turntable.spec
    finally:
        del sys.modules["watched_bodies"]
    assert len(closed) == 1


# ---- a body beside the experiment file ----

LAMP = """
class Lamp:
    spec, made_by = None, "{by}"
    def __init__(self, watts=40): self.watts = watts
    def reset(self, seed, episode): ...
    act = halt = scene = state = restore = close = reset
"""


@pytest.fixture
def beside(monkeypatch, tmp_path):
    """A folder as that of an experiment file, which the rest of the session does not know of."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    known = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - known:
        if (getattr(sys.modules[name], "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


def test_a_body_beside_the_experiment_file_is_found(beside):
    (beside / "lamps_of_mine.py").write_text(LAMP.format(by="me"))
    with pytest.raises(BodyError, match="put it beside the experiment file"):
        make_body("lamps_of_mine:Lamp", {})
    lamp = make_body("lamps_of_mine:Lamp", {"watts": 60}, beside)
    assert (lamp.watts, lamp.made_by) == (60, "me")
    assert make_body("lamps_of_mine:Lamp", {}, beside).watts == 40


def test_a_package_beside_the_experiment_file_is_found_also_by_a_relative_folder(beside, monkeypatch):
    (beside / "lamp_shop" / "deep").mkdir(parents=True)
    (beside / "lamp_shop" / "__init__.py").touch()
    (beside / "lamp_shop" / "deep" / "__init__.py").write_text(LAMP.format(by="me"))
    monkeypatch.chdir(beside)
    assert make_body("lamp_shop.deep:Lamp", {}, Path()).made_by == "me"
    assert str(beside.resolve()) in sys.path, "and not '.', which is elsewhere later"


def test_a_file_beside_the_experiment_takes_no_module_of_the_project_s_place(beside):
    (beside / "mdb_sim").mkdir()
    (beside / "mdb_sim" / "__init__.py").touch()
    for name in ("msgspec.py", "json.py", "mdb_sim/lamps.py"):
        (beside / name).write_text(LAMP.format(by="an impostor"))
    script = (
        "import sys, pathlib; sys.modules.pop('json', None); folder = pathlib.Path(sys.argv[1])\n"
        "from mdb_sim.bodies.finding import BodyError, find\n"
        "for module in ('msgspec', 'json', 'mdb_sim.lamps', 'mdb_sim'):\n"
        "    try:\n"
        "        find(module + ':Lamp', folder, 'body', {})\n"
        "    except BodyError as error:\n"
        "        print(error)\n"
        "import mdb_sim, msgspec, json\n"
        "print([m.__file__.startswith(str(folder)) for m in (mdb_sim, msgspec, json)])\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script, str(beside)], capture_output=True, text=True, timeout=60, check=True
    )
    *refused, last = run.stdout.splitlines()
    assert len(refused) == 4
    assert last == "[False, False, False]"


def test_the_folder_is_looked_in_once_and_last(beside):
    (beside / "lamps_of_mine.py").write_text(LAMP.format(by="me"))
    before = list(sys.path)
    for _ in range(2):
        make_body("lamps_of_mine:Lamp", {}, beside)
    assert sys.path == [*before, str(beside.resolve())]


def test_what_is_missing_in_a_module_beside_is_named_and_not_the_module(beside):
    (beside / "lamps_of_mine.py").write_text("import no_such_driver\n")
    with pytest.raises(BodyError, match="importing lamps_of_mine failed: No module named 'no_such_driver'"):
        make_body("lamps_of_mine:Lamp", {}, beside)


@pytest.mark.parametrize("text", ["class Lamp:\n  def", "from mdb_sim.body import NoSuchName\n"])
def test_a_module_beside_that_cannot_be_imported_is_named(beside, text):
    (beside / "lamps_of_mine.py").write_text(text)
    with pytest.raises(BodyError, match="importing lamps_of_mine failed"):
        make_body("lamps_of_mine:Lamp", {}, beside)


def test_a_class_beside_that_is_no_body_is_told_what_it_lacks(beside):
    (beside / "lamps_of_mine.py").write_text(LAMP.format(by="me").replace("scene = state = ", ""))
    with pytest.raises(
        BodyError, match=r"gave a Lamp without scene, state; expected the members of mdb_sim\.body\.Body"
    ):
        make_body("lamps_of_mine:Lamp", {}, beside)


def test_each_member_of_the_contract_is_asked_for(beside):
    for member in MEMBERS:
        module = f"lamps_without_{member}"
        (beside / f"{module}.py").write_text(f"{LAMP.format(by='me')}\n    del {member}\n")
        with pytest.raises(BodyError, match=f"gave a Lamp without {member};"):
            make_body(f"{module}:Lamp", {}, beside)


def test_what_is_looked_for_is_in_the_words_of_who_looks():
    with pytest.raises(BodyError, match=r"no policy named 'want'; expected 'reach' or 'package\.module:Factory'"):
        find("want", None, "policy", {"reach": "somewhere:Reach"})
