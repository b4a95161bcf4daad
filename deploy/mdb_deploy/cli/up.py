"""`mdb up`: an experiment, and then its figures."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mdb_deploy.cli.options import OPEN_HELP, Commands, add_experiment, content_of, keys_path, number
from mdb_deploy.cli.plot import draw
from mdb_deploy.experiments import experiment_path
from mdb_protocol.endpoints import USUAL
from mdb_protocol.errors import MdbError

if TYPE_CHECKING:
    from rich.console import Console

    from mdb_deploy.running.up import Web
    from mdb_deploy.supervision.template import Template
    from mdb_sim.runs.experiment import Experiment

NOTHING_DONE = 2
"""Exit status of a run that ended well and of which no iteration is in the log."""


def add(commands: Commands) -> None:
    """Add `up`."""
    up = commands.add_parser("up", help="run an experiment, then draw its figures", allow_abbrev=False)
    add_experiment(up)
    up.add_argument("--inline", action="store_true", help="everything in this process, in lockstep")
    up.add_argument("--runs", type=Path, default=Path("runs"), help="where the run folder is made (runs)")
    up.add_argument("--listen", help=f"the router's endpoint ({USUAL}); port 0: any free one")
    up.add_argument("--connect", metavar="ENDPOINT", help="start no router: join the one that runs there")
    up.add_argument("--keys", type=keys_path, metavar="DIR", help="key folder, for a router at tls/ or quic/")
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
        "--no-teacher",
        action="store_true",
        help="no scripted teacher: it begins when you teach (--web, or mdb teach)",
    )
    up.add_argument(
        "--no-robot", action="store_true", help="no robot of ours: it begins when yours is there (mdb keys duties)"
    )
    up.add_argument("--web", action="store_true", help="with a page: watch and teach it in the browser (extra 'web')")
    up.add_argument("--web-port", type=number(1, 65535), metavar="N", help="the page's port (8787, or the next free)")
    up.set_defaults(command=_up, goes_on=True)


def _check_words(arguments: argparse.Namespace) -> None:
    """Raise MdbError when options do not go together."""
    if arguments.inline and (arguments.no_robot or arguments.connect):
        raise MdbError("--inline runs everything in one process: leave --no-robot and --connect out")
    if arguments.connect and (arguments.listen or arguments.open_to_everyone):
        raise MdbError("--connect starts no router: leave --listen and --open-to-everyone out")
    if arguments.inline and (arguments.web or arguments.web_port):
        raise MdbError("--inline runs everything in one process, without a page: leave --web out")
    if arguments.no_robot and arguments.gui:
        raise MdbError("--gui shows the PyBullet window of our robot: leave it out with --no-robot")
    if arguments.resume is not None and (arguments.inline or arguments.long_term):
        raise MdbError("--resume goes on with a run of processes as it was: leave --inline and --long-term out")


def _up(arguments: argparse.Namespace) -> int:
    _check_words(arguments)
    from mdb_deploy.cli.main import main
    from mdb_deploy.supervision.template import Template, kept, one_thread

    if arguments.inline:
        with kept():
            experiment = _wanted(arguments)
            import mdb_sim.runs.inline  # noqa: F401 - with all that it needs
        return _run(arguments, experiment, None)
    with one_thread():
        experiment = _wanted(arguments)
        experiment.keep()  # for the services
        template = Template.begin(main)
    try:
        return _run(arguments, experiment, template)
    finally:
        if template is not None:
            template.close()


def _wanted(arguments: argparse.Namespace) -> Experiment:
    """Return the experiment, with all that is said beside it; MdbError when it cannot be begun."""
    from mdb_deploy.running.up import check_listen
    from mdb_services.experiment.run_folder import EXPERIMENT_FILE
    from mdb_sim.runs.experiment import Experiment

    path = experiment_path(arguments.experiment) if arguments.resume is None else arguments.resume / EXPERIMENT_FILE
    content = content_of(path, arguments, *(("experiment.pace=lockstep",) if arguments.inline else ()))
    if arguments.no_teacher:
        content.get("teacher", {}).pop("phase", None)  # what can be wanted stays
    experiment = Experiment(content, path)
    experiment.check_machine(elsewhere=arguments.no_robot, gui=arguments.gui)
    if not (arguments.connect or arguments.inline):
        brain = experiment.brain.experiment.brain
        check_listen(arguments.listen or USUAL, arguments.keys, brain, open_to_everyone=arguments.open_to_everyone)
    return experiment


def _run(arguments: argparse.Namespace, experiment: Experiment, template: Template | None) -> int:
    from mdb_deploy.running.console import console_of
    from mdb_deploy.running.progress import Progress
    from mdb_deploy.running.up import UpOptions, check_connect, new_run_folder, up_inline, up_processes
    from mdb_deploy.supervision.processes import ENDPOINT_FILE
    from mdb_services.experiment.run_folder import EXPERIMENT_FILE

    section, listen = experiment.brain.experiment, arguments.listen or USUAL
    if arguments.connect:  # which has threads
        check_connect(arguments.connect, arguments.keys, section.brain)
    run = arguments.resume or new_run_folder(arguments.runs.resolve(), section.name, section.seed)
    run = run.resolve()
    if arguments.long_term is not None:
        from mdb_deploy.runs import ltm

        experiment.write(run / EXPERIMENT_FILE)
        ltm.bring(arguments.long_term, (), run)
    console = console_of(sys.stdout)
    web = _web(arguments, listen, run, console)
    options = UpOptions(
        run,
        listen,
        arguments.gui,
        arguments.keys,
        arguments.open_to_everyone,
        await_teacher=arguments.no_teacher,
        await_robot=arguments.no_robot,
        connect=arguments.connect,
        web=web,
        template=template,
    )
    console.print(f"{section.name}: {section.iterations} iterations, {section.pace}, seed {section.seed}")
    where = arguments.connect or (f"$(cat {run / ENDPOINT_FILE})" if listen.endswith(":0") else listen)
    if arguments.no_robot:
        console.print(f"begins when a robot comes to mdb/{section.brain} at {where}", soft_wrap=True)
    if arguments.no_teacher and not arguments.inline:
        bundle = " --keys YOUR_BUNDLE" if arguments.keys else ""
        console.print(f"begins when somebody teaches: mdb teach --connect {where}{bundle}", soft_wrap=True)
    results = _Results(run, console, plot=not arguments.no_plot)
    progress = Progress(console, experiment)
    if arguments.inline:
        status = up_inline(experiment, options, progress)
        results.draw()
    else:
        status = up_processes(experiment, options, progress, results.draw)
    return status or results.status


class _Results:
    """What is made of a run when it is over."""

    def __init__(self, run: Path, console: Console, *, plot: bool) -> None:
        self._run, self._console, self._plot = run, console, plot
        self.status = 0
        """The exit status of the command, as far as it depends on them."""

    def draw(self) -> None:
        """Draw the figures, and say where the results are; MdbError when the run folder is gone."""
        from mdb_services.experiment.run_folder import EXPERIMENT_FILE
        from mdb_services.recorder import EmptyLogError

        run, console = self._run, self._console
        if not (run / EXPERIMENT_FILE).exists():
            raise MdbError(f"the run folder {run} was deleted or moved away: there are no results in its place")
        if self._plot:
            console.print("drawing the figures")
            try:
                draw([run], None)
            except EmptyLogError as error:
                console.print(f"no figures: {error}", soft_wrap=True)
                self.status = NOTHING_DONE
        console.print(f"results: {run}", soft_wrap=True)


def _web(arguments: argparse.Namespace, listen: str, run: Path, console: Console) -> Web | None:
    """Return the page of this run, None without one; MdbError, before anything is started, when it cannot be."""
    if not (arguments.web or arguments.web_port):
        return None
    arguments.extra = "web"
    from mdb_deploy.running.up import Web
    from mdb_deploy.web.opening import Place, WebOptions, bind, check, check_packages, guard_of
    from mdb_protocol import endpoints

    check_packages()
    host = "127.0.0.1" if arguments.keys is None else endpoints.parse(listen).host
    options = WebOptions(Place(keys=arguments.keys), host, arguments.web_port)
    check(options)
    listening = bind(host, arguments.web_port)
    port = listening.getsockname()[1]
    guard = guard_of(options, port)

    def say() -> None:
        for line in guard.lines():
            console.print(line, soft_wrap=True)

    return Web(listening, host, port, run.parent, say, lambda: console.print("the page goes on; Ctrl-C ends it"))
