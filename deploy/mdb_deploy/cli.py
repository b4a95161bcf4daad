"""The command line `mdb`: see `mdb --help`."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import TextIO, cast

import structlog

from mdb_deploy import keys_command
from mdb_deploy.studies import parser as studies_parser
from mdb_protocol.errors import MdbError
from mdb_protocol.zenoh_bus import DEFAULT_ENDPOINT

EPILOG = """\
first steps:
  mdb up                                  the paper's experiment, in processes over Zenoh, with figures
  mdb up --pace lockstep --seed 3         the same, repeatable value by value
  mdb up --inline --iterations 600        in one process, without a router
  mdb up my.toml --set evolution.population=400 --set robot.body=kinematic
  mdb up --no-teacher                     you teach, with 'mdb teach' in another terminal
  mdb status                              who is alive, and how each process does
  mdb plot RUN                            the figures again, from the run's log alone
"""
EXPERIMENTS = Path(__file__).parents[1] / "experiments"


class Unbreakable:
    """A stream that loses what cannot be written: no service is to fail because its log is on a full disk."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.flush()


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = _parser()
    arguments, words = parser.parse_known_args(argv)
    if words and arguments.command is not _test:
        parser.error(f"unrecognized arguments: {' '.join(words)}")
    arguments.words = words
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=structlog.PrintLoggerFactory(cast(TextIO, Unbreakable(sys.stderr))),
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S.%f", utc=False),
            structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty()),
        ],
    )
    try:
        status: int = arguments.command(arguments)
    except MdbError as error:
        sys.stderr.write(f"mdb: {error}\n")
        return 2
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("mdb_"):
            raise
        extra = "teach" if arguments.command is _teach else "brain"
        wanted = f"pip install 'multilevel-darwinist-brain[{extra}]'"
        sys.stderr.write(f"mdb: this needs {error.name}, which is not installed: {wanted}\n")
        return 2
    except KeyboardInterrupt:
        return 130
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mdb",
        description="A robot learns from a teacher: the Multilevel Darwinist Brain over Eclipse Zenoh.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_up(commands)
    _add_run(commands)
    _add_teach(commands)
    _add_chaos(commands)
    _add_small(commands)
    keys_command.add(commands)
    studies_parser.add(commands)
    _add_ltm(commands)
    return parser


Commands = argparse._SubParsersAction
KEYS_HELP = "your bundle of 'mdb keys', or on the brain's machine the key folder; for a router at tls/ or quic/"
OPEN_HELP = "listen beyond this machine without keys: everyone there may read all and command the robot"


def _keys_path(text: str) -> Path | None:
    return Path(text).resolve() if text else None  # compose.yaml gives an empty word for none


def _add_keys(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--keys", type=_keys_path, metavar="PATH", help=KEYS_HELP)


def _add_experiment(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "experiment", nargs="?", default="paper", help="experiment file, or the name of a shipped one (paper)"
    )
    parser.add_argument("--pace", choices=["concurrent", "lockstep"], help="override the file's pace")
    parser.add_argument("--seed", type=int, help="override the file's seed")
    parser.add_argument("--iterations", type=int, help="override the file's number of iterations")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="override any setting")


def _add_up(commands: Commands[argparse.ArgumentParser]) -> None:
    up = commands.add_parser("up", help="run an experiment to its figures", allow_abbrev=False)
    _add_experiment(up)
    up.add_argument("--inline", action="store_true", help="everything in this process, in lockstep")
    up.add_argument("--runs", type=Path, default=Path("runs"), help="where the run folder is made (runs)")
    up.add_argument("--listen", default=DEFAULT_ENDPOINT, help="the router's endpoint; port 0: any free one")
    up.add_argument("--keys", type=_keys_path, metavar="DIR", help="key folder, for --listen tls/0.0.0.0:7447")
    up.add_argument("--open-to-everyone", action="store_true", help=OPEN_HELP)
    up.add_argument("--gui", action="store_true", help="show the PyBullet window")
    up.add_argument(
        "--long-term", type=Path, metavar="SOURCE", help="begin with the models of a run or of an 'mdb ltm export'"
    )
    up.add_argument("--no-plot", action="store_true", help="no figures at the end")
    up.add_argument(
        "--resume", type=Path, metavar="RUN", help="go on with the run in this folder, its experiment included"
    )
    up.add_argument(
        "--no-teacher", action="store_true", help="no scripted teacher: begin when you have come, 'mdb teach'"
    )
    up.set_defaults(command=_up)


def _add_run(commands: Commands[argparse.ArgumentParser]) -> None:
    run = commands.add_parser("run", help="run one service (compose does this)", allow_abbrev=False)
    run.add_argument("service", help="router, recorder, memory, evolver, optimizer, robot, teacher or ear")
    run.add_argument("--run", type=Path, help="run folder with experiment.toml")
    run.add_argument("--connect", default=DEFAULT_ENDPOINT, help="the router's endpoint")
    run.add_argument("--listen", help="router: its endpoint; port 0: any free one")
    _add_keys(run)
    run.add_argument("--open-to-everyone", action="store_true", help=f"router: {OPEN_HELP}")
    run.add_argument("--model", help="evolver: the model it evolves")
    run.add_argument("--gui", action="store_true", help="robot: show the PyBullet window")
    run.add_argument("--with-parent", type=int, metavar="PID", help="stop when this, the parent process, is gone")
    run.set_defaults(command=_run)
    prepare = commands.add_parser("prepare", help="write the resolved experiment into a run folder")
    _add_experiment(prepare)
    prepare.add_argument("--run", type=Path, required=True, help="run folder, made if it is not there")
    prepare.set_defaults(command=_prepare)


TEACH_EPILOG = """\
notes        z x c v b n m (then a s d f g), one each; space: silence
feedback     0 (punishment, -1) to 9 (reward, +1) in steps of 2/9; + and - for the whole; for the action on the screen
language     what your notes mean is yours alone: l changes it at any time, --language begins with
             'reversed' (the keys lie as the turns do), 'ordered', 'paper', 'random:SEED' or 'notes:3,0,1,...'
p pause      there but silent, so that the brain need not wait; q leaves

a brain that waits longer for a person, and its teacher:
  mdb up --no-teacher --set optimizer.command_patience_s=20 --set optimizer.feedback_patience_s=5
  mdb teach --name ann
"""


def _add_teach(commands: Commands[argparse.ArgumentParser]) -> None:
    teach = commands.add_parser(
        "teach",
        help="teach a brain from this terminal",
        description="See the robot, say notes, reward and punish. Needs the extra 'teach' only.",
        epilog=TEACH_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    teach.add_argument("--connect", default=DEFAULT_ENDPOINT, help="the router's endpoint")
    _add_keys(teach)
    teach.add_argument("--brain", help="the brain's name (as your keys say, or pioneer)")
    teach.add_argument("--name", help="your name among the teachers (as your keys say, or teacher)")
    teach.add_argument("--language", default="reversed", help="what your notes mean at the beginning (reversed)")
    teach.add_argument("--suggest", action="store_true", help="begin with the hint on: which command would be right")
    teach.add_argument("--auto", action="store_true", help="teach by itself, as the scripted teacher does")
    teach.add_argument(
        "--experiment",
        type=experiment_path,
        metavar="FILE",
        help="whose [robot.world] says what the actions are, whose [ear] the scale",
    )
    teach.add_argument("--sound", metavar="INSTRUMENT", help="play the notes instead of naming them, as in flute")
    teach.add_argument("--microphone", action="store_true", help="the brain hears your microphone (extra 'sound')")
    teach.set_defaults(command=_teach)


CHAOS_EPILOG = """\
recovery: from the kill until the successor's liveliness token is there (after the router's: everybody's) and two
more iterations are done. A witness, a process outside the brain, writes down what is acknowledged; in the end all of
that must be in the memory, once, as it was. Status 1 when it is not, or recovery is far too slow.

  mdb chaos                                      300 kills, the paper's experiment over and over: some ten minutes
  mdb chaos --kills 12 --roles memory,optimizer --set robot.body=kinematic
  mdb chaos --pace lockstep --iterations 500     to the experiment's end, however many kills fit in
  mdb chaos --soak 60                            no kills: full speed, and what each process holds
"""


def _add_chaos(commands: Commands[argparse.ArgumentParser]) -> None:
    chaos = commands.add_parser(
        "chaos",
        help="kill processes of a brain at random, and see that nothing is lost",
        description="Kills processes of a running brain at random, and measures what comes of it.",
        epilog=CHAOS_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    _add_experiment(chaos)
    chaos.add_argument("--kills", type=int, default=300, help="how many (300)")
    chaos.add_argument("--roles", default="", help="who may die, as in memory,evolver-object (everybody)")
    chaos.add_argument("--bound", type=float, default=20.0, metavar="SECONDS", help="give up on a recovery (20)")
    chaos.add_argument("--pause", type=float, default=1.0, metavar="SECONDS", help="to the next kill, at most (1)")
    chaos.add_argument("--soak", type=float, metavar="MINUTES", help="watch memory, threads and files instead")
    chaos.add_argument("--out", type=Path, default=Path("runs/chaos"), help="where run and report go (runs/chaos)")
    chaos.set_defaults(command=_chaos)


def _add_small(commands: Commands[argparse.ArgumentParser]) -> None:
    test = commands.add_parser("test", help="run the tests; all further words go to pytest", add_help=False)
    test.set_defaults(command=_test)
    plot = commands.add_parser("plot", help="draw the figures of a run from its log alone")
    plot.add_argument("run", type=Path, nargs="+", help="run folder; several: one figure with a confidence band")
    plot.add_argument("--out", type=Path, help="where the figures go (the run folder)")
    plot.set_defaults(command=_plot)
    replay = commands.add_parser(
        "replay",
        help="replay services of a recorded run alone against its log",
        description="Each service hears what it heard then, and must say what it said then, value by value; "
        "otherwise the exit status is 1. Of a concurrent run robot, teacher, ear and evolvers can be replayed.",
    )
    replay.add_argument("run", type=Path, metavar="RUN", help="run folder")
    replay.add_argument("roles", nargs="*", metavar="ROLE", help="as memory, evolver, evolver/object, robot (all)")
    replay.add_argument(
        "--tolerance", type=float, default=0.0, help="by which floats may differ: a log of another processor (0)"
    )
    replay.set_defaults(command=_replay)
    status = commands.add_parser("status", help="who is alive, and how each process does")
    health = commands.add_parser("health", help="exit status 0 when ROLE/INSTANCE (or the router) is ready")
    health.add_argument("name", help="router, or ROLE/INSTANCE as in 'mdb status'")
    for parser in (status, health):
        parser.add_argument("--connect", default=DEFAULT_ENDPOINT, help="the router's endpoint")
        parser.add_argument("--brain", default="pioneer", help="the brain's name")
        _add_keys(parser)
    status.add_argument("--json", action="store_true", help="one line of JSON, for scripts")
    status.add_argument(
        "--watch", type=float, nargs="?", const=1.0, metavar="SECONDS", help="again and again (every second)"
    )
    status.set_defaults(command=_status)
    health.set_defaults(command=_health)
    rescue = commands.add_parser("rescue", help="a new run folder from one whose memory file is damaged")
    rescue.add_argument("run", type=Path, metavar="RUN", help="run folder, in which nothing is changed")
    rescue.add_argument("--out", type=Path, required=True, metavar="NEW", help="the new one, for 'mdb up --resume'")
    rescue.set_defaults(command=_rescue)
    warm_up = commands.add_parser("warm-up", help="compile the evolvers' kernels (the first start does it too)")
    warm_up.set_defaults(command=_warm_up)
    compare = commands.add_parser("compare-bodies", help="PyBullet and its kinematic twin side by side")
    compare.set_defaults(command=_compare)


def _add_ltm(commands: Commands[argparse.ArgumentParser]) -> None:
    ltm = commands.add_parser(
        "ltm",
        help="the long-term memory: list, show, export, import",
        description="Models that were good and stable, each with a sample of its context. SOURCE: a run folder or "
        "a file that 'export' wrote. MODEL: a model's name, for all stored under it, or NAME/ID.",
    )
    verbs = ltm.add_subparsers(required=True, metavar="VERB")
    listing = verbs.add_parser("list", help="one line a model")
    show = verbs.add_parser("show", help="all that is known of a model")
    export = verbs.add_parser("export", help="write models to a file")
    bring = verbs.add_parser("import", help="put models into a run that has not begun, or is stopped")
    for verb in (listing, show, export, bring):
        verb.add_argument("source", type=Path, metavar="SOURCE")
    bring.add_argument("run", type=Path, metavar="RUN", help="run folder ('mdb prepare --run RUN' makes one)")
    for verb in (listing, show, export, bring):
        verb.add_argument("models", nargs="*", metavar="MODEL", help="which models (all)")
    export.add_argument("--out", type=Path, required=True, metavar="FILE", help="the file to write")
    listing.set_defaults(command=_ltm_list)
    show.set_defaults(command=_ltm_show)
    export.set_defaults(command=_ltm_export)
    bring.set_defaults(command=_ltm_import)


def _ltm_list(arguments: argparse.Namespace) -> int:
    from mdb_deploy import ltm

    sys.stdout.write(ltm.listing(ltm.read(arguments.source, arguments.models)) + "\n")
    return 0


def _ltm_show(arguments: argparse.Namespace) -> int:
    from mdb_deploy import ltm

    sys.stdout.write("\n\n".join(map(ltm.show, ltm.read(arguments.source, arguments.models))) + "\n")
    return 0


def _ltm_export(arguments: argparse.Namespace) -> int:
    from mdb_deploy import ltm

    count = ltm.export(arguments.source, arguments.models, arguments.out)
    sys.stdout.write(f"{count} models: {arguments.out}\n")
    return 0


def _ltm_import(arguments: argparse.Namespace) -> int:
    from mdb_deploy import ltm

    count = ltm.bring(arguments.source, arguments.models, arguments.run)
    sys.stdout.write(f"{count} models: {arguments.run}\n")
    return 0


def experiment_path(name: str) -> Path:
    """Return the path of an experiment file, or of a shipped one by its name."""
    shipped = EXPERIMENTS / f"{name}.toml"
    return shipped if shipped.exists() and not Path(name).exists() else Path(name)


def overrides_of(arguments: argparse.Namespace) -> list[str]:
    """Return the options that stand for settings as overrides, the explicit ones last."""
    named = {"pace": arguments.pace, "seed": arguments.seed, "iterations": arguments.iterations}
    given = [f"experiment.{name}={value}" for name, value in named.items() if value is not None]
    return given + list(arguments.set)


def _up(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from mdb_deploy.processes import ENDPOINT_FILE
    from mdb_deploy.progress import Progress
    from mdb_deploy.up import UpOptions, check_listen, new_run_folder, up_inline, up_processes
    from mdb_services.config import EXPERIMENT_FILE, read_file
    from mdb_sim.experiment import Experiment

    overrides = overrides_of(arguments)
    if arguments.inline:
        overrides.append("experiment.pace=lockstep")
    path = experiment_path(arguments.experiment) if arguments.resume is None else arguments.resume / EXPERIMENT_FILE
    content = read_file(path, overrides)
    if arguments.no_teacher:
        content.pop("teacher", None)
    experiment = Experiment(content, path)
    section = experiment.brain.experiment
    if not arguments.inline:
        check_listen(arguments.listen, arguments.keys, section.brain, open_to_everyone=arguments.open_to_everyone)
    if arguments.resume is not None and (arguments.inline or arguments.long_term):
        raise MdbError("--resume goes on with a run of processes as it was: leave --inline and --long-term out")
    run = arguments.resume or new_run_folder(arguments.runs.resolve(), section.name, section.seed)
    run = run.resolve()
    if arguments.long_term is not None:
        from mdb_deploy import ltm

        experiment.write(run / EXPERIMENT_FILE)
        ltm.bring(arguments.long_term, (), run)
    options = UpOptions(
        run,
        arguments.listen,
        arguments.gui,
        arguments.keys,
        arguments.open_to_everyone,
        await_teacher=arguments.no_teacher,
    )
    console = Console(stderr=False)
    console.print(f"{section.name}: {section.iterations} iterations, {section.pace}, seed {section.seed}")
    if arguments.no_teacher and not arguments.inline:
        listen = f"$(cat {run / ENDPOINT_FILE})" if arguments.listen.endswith(":0") else arguments.listen
        bundle = " --keys YOUR_BUNDLE" if arguments.keys else ""
        console.print(f"begins when somebody teaches: mdb teach --connect {listen}{bundle}", soft_wrap=True)
    run_it = up_inline if arguments.inline else up_processes
    status = run_it(experiment, options, Progress(console, section.iterations))
    if not arguments.no_plot:
        console.print("drawing the figures")
        _draw([run], None)
    console.print(f"results: {run}", soft_wrap=True)
    return status


def _teach(arguments: argparse.Namespace) -> int:
    from mdb_deploy.teach.run import TeachOptions, teach

    return teach(
        TeachOptions(
            connect=arguments.connect,
            brain=arguments.brain,
            name=arguments.name,
            keys=arguments.keys,
            language=arguments.language,
            experiment=arguments.experiment,
            suggest=arguments.suggest,
            auto=arguments.auto,
            sound=arguments.sound,
            microphone=arguments.microphone,
        )
    )


def _chaos(arguments: argparse.Namespace) -> int:
    path, overrides, out = experiment_path(arguments.experiment), tuple(overrides_of(arguments)), arguments.out
    if arguments.soak is not None:
        from mdb_deploy import soak

        return soak.command(soak.SoakOptions(path, overrides, out, arguments.soak))
    from mdb_deploy import chaos

    return chaos.command(
        chaos.ChaosOptions(
            path,
            overrides,
            out,
            kills=arguments.kills,
            seed=arguments.seed or 0,
            roles=tuple(name for name in arguments.roles.split(",") if name),
            bound_s=arguments.bound,
            pause_s=arguments.pause,
            to_the_end=arguments.iterations is not None,
        )
    )


def _run(arguments: argparse.Namespace) -> int:
    from mdb_deploy.processes import RouterOptions, ServiceOptions, run_router, run_service
    from mdb_services.service import Stopper

    stop = Stopper(arguments.with_parent)
    stop.install()
    if arguments.service == "router":
        options = RouterOptions(arguments.run, arguments.listen, arguments.keys, arguments.open_to_everyone)
        run_router(options, stop)
        return 0
    if arguments.run is None:
        raise MdbError(f"mdb run {arguments.service} needs --run FOLDER; 'mdb prepare --run FOLDER' makes one")
    service = ServiceOptions(arguments.run, arguments.connect, arguments.model, arguments.gui, arguments.keys)
    run_service(arguments.service, service, stop)
    return 0


def _prepare(arguments: argparse.Namespace) -> int:
    from mdb_services.config import EXPERIMENT_FILE
    from mdb_sim.experiment import Experiment

    experiment = Experiment.read(experiment_path(arguments.experiment), overrides_of(arguments))
    arguments.run.mkdir(parents=True, exist_ok=True)
    experiment.write(arguments.run / EXPERIMENT_FILE)
    return 0


def _test(arguments: argparse.Namespace) -> int:
    try:
        import pytest
    except ModuleNotFoundError as error:
        raise MdbError("the tests need pytest: pip install -e '.[test]', or use ./deploy/compose test") from error
    root = Path(__file__).parents[2]
    os.chdir(root)
    results = root / "runs" / "tests.xml"
    status = int(pytest.main([f"--junit-xml={results}", *arguments.words]))
    sys.stdout.write(f"results: {results}\n")
    return status


def _plot(arguments: argparse.Namespace) -> int:
    for path in _draw(arguments.run, arguments.out):
        sys.stdout.write(f"{path}\n")
    return 0


def _draw(runs: list[Path], out: Path | None) -> list[Path]:
    from mdb_sim.figures import draw, draw_band

    return draw(runs[0], out) if len(runs) == 1 else draw_band(runs, out or Path())


def _replay(arguments: argparse.Namespace) -> int:
    from mdb_deploy.replay import replay_run

    return replay_run(arguments.run, arguments.roles, arguments.tolerance)


def _rescue(arguments: argparse.Namespace) -> int:
    from mdb_deploy.rescue import rescue_run

    found = rescue_run(arguments.run, arguments.out)
    sys.stdout.write(f"{found.words()}\ngo on with: mdb up --resume {arguments.out}\n")
    return 0


def _status(arguments: argparse.Namespace) -> int:
    from mdb_deploy.status import show_status

    return show_status(
        arguments.brain, arguments.connect, arguments.keys, as_json=arguments.json, every_s=arguments.watch
    )


def _health(arguments: argparse.Namespace) -> int:
    from mdb_protocol.zenoh_bus import ZenohBus

    with ZenohBus(arguments.brain, arguments.connect, credentials=arguments.keys, connect_timeout_s=1.0) as bus:
        return 0 if arguments.name == "router" or arguments.name in bus.alive() else 1


def _warm_up(_: argparse.Namespace) -> int:
    from mdb_services.evolver import compile_kernels

    compile_kernels()
    return 0


def _compare(_: argparse.Namespace) -> int:
    from mdb_sim.twins import compare_bodies

    sys.stdout.write(f"{compare_bodies().table()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
