import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from mdb_deploy.experiments import experiment_path
from mdb_deploy.supervision.compose import COMPOSE_FILE, fill, for_experiment, in_order, read
from mdb_protocol.errors import ConfigError
from mdb_sim.runs.experiment import Experiment


def experiment(*settings: str) -> Experiment:
    return Experiment.read(experiment_path("paper"), settings)


def test_every_process_comes_after_those_it_waits_for() -> None:
    specs = list(read().values())
    names = [spec.name for spec in specs]
    assert names[0] == "router"
    assert names[-1] == "optimizer"
    for spec in specs:
        assert all(names.index(other) < names.index(spec.name) for other in spec.after)


def test_paper_needs_one_evolver_a_model() -> None:
    specs = for_experiment(read(), experiment())
    assert {s.token for s in specs.values() if s.token.startswith("evolver/")} == {
        "evolver/communication",
        "evolver/object",
        "evolver/induced",
    }


def test_another_model_gets_an_evolver_and_a_missing_one_none() -> None:
    content = experiment().content
    content["model"][2]["name"] = "mine"
    content["mode"][1]["satisfaction"] = "mine"
    specs = for_experiment(read(), Experiment(content, "test"))
    assert "evolver-induced" not in specs
    assert specs["evolver-mine"].command[:5] == ("mdb", "run", "evolver", "--model", "mine")
    assert "evolver-mine" in specs["optimizer"].after
    assert "evolver-induced" not in specs["optimizer"].after


def test_without_a_teacher_section_no_teacher_is_started() -> None:
    content = experiment().content
    del content["teacher"]
    specs = for_experiment(read(), Experiment(content, "test"))
    assert "teacher" not in specs
    assert "teacher" not in specs["optimizer"].after


def test_with_an_ear_section_an_ear_is_started_before_the_optimizer_and_else_none() -> None:
    specs = for_experiment(read(), experiment("ear.detector=template"))
    assert specs["ear"].token == "ear/notes"
    assert "ear" in specs["optimizer"].after
    without = for_experiment(read(), experiment())
    assert "ear" not in without
    assert "ear" not in without["optimizer"].after


def test_variables_take_their_value_or_default() -> None:
    assert fill("${A:-tcp/x:1}", {}) == "tcp/x:1"
    assert fill("${A:-tcp/x:1}", {"A": "y"}) == "y"
    with pytest.raises(ConfigError, match="no value and no default"):
        fill("${B}", {})


def test_the_router_is_open_in_containers_alone() -> None:
    router = read()["router"]
    inside = {"MDB_RUN_INSIDE": "/run", "MDB_LISTEN": "tcp/0.0.0.0:7447"}
    assert router.argv(inside)[-2:] == ["--keys=", "--open-to-everyone"]
    assert router.argv(inside | {"MDB_KEYS": "/keys", "MDB_OPEN": ""})[-1] == "--keys=/keys"
    assert yaml.safe_load(COMPOSE_FILE.read_text())["services"]["router"]["ports"] == ["127.0.0.1:7447:7447"]


def test_circle_is_refused() -> None:
    specs = read()
    from dataclasses import replace

    specs["router"] = replace(specs["router"], after=("optimizer",))
    with pytest.raises(ConfigError, match="goes in a circle"):
        in_order(specs)


def test_unusable_compose_files_are_said(tmp_path: Path) -> None:
    path = tmp_path / "compose.yaml"
    with pytest.raises(ConfigError, match="not a usable compose file"):
        read(path)
    path.write_text("services: {a: {command: [mdb, run, a]}}")
    with pytest.raises(ConfigError, match=r"service a needs healthcheck\.test"):
        read(path)
    path.write_text("services: {a: {image: x}}")
    with pytest.raises(ConfigError, match="service a needs a command"):
        read(path)


def test_docker_compose_reads_the_same_file() -> None:
    """Docker's own reader where it is installed; elsewhere what it would check first: every name exists."""
    services = yaml.safe_load(COMPOSE_FILE.read_text())["services"]
    for name, service in services.items():
        assert {"image", "command", "restart"} <= set(service), name
        assert set(service.get("depends_on", {})) <= set(services), name
    for command in (["docker", "compose"], ["docker-compose"]):
        if shutil.which(command[0]):
            version = subprocess.run([*command, "version"], capture_output=True, check=False)
            if version.returncode == 0:
                config = [*command, "-p", "mdb", "-f", str(COMPOSE_FILE), "config", "--quiet"]
                result = subprocess.run(config, capture_output=True, text=True, check=False)
                assert result.returncode == 0, result.stderr


def test_the_page_is_there_when_it_is_wanted_and_nobody_waits_for_it() -> None:
    specs, paper = read(), Experiment.read(experiment_path("paper"))
    assert "web" not in for_experiment(specs, paper)
    chosen = for_experiment(specs, paper, web=True)
    assert not chosen["web"].needed
    assert chosen["web"].after == ()
    assert chosen["web"].token == "web/console"
    assert not any("web" in spec.after for spec in chosen.values())
