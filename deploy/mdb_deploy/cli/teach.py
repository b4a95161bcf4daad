"""`mdb teach`: a person teaches from a terminal."""

from __future__ import annotations

import argparse

from mdb_deploy.cli.options import Commands, add_keys
from mdb_deploy.experiments import experiment_path
from mdb_protocol.endpoints import USUAL

TEACH_EPILOG = """\
Play a note, see what the robot does, judge it; again and again, until it obeys. Then leave, and see it go on alone.

notes        z x c v b n m (then a s d f g), one each; space: silence
feedback     0 (punishment, -1) to 9 (reward, +1) in steps of 2/9; + and - for the whole; for the action on the screen
w wait       the brain waits for you, at most ten minutes for each note; w again: no longer
h hint       which note would be right; it is on at first
language     what your notes mean is yours alone: l changes it at any time, --language begins with
             'reversed' (the keys lie as the turns do), 'ordered', 'paper', 'random:SEED' or 'notes:3,0,1,...'
p pause      you are there but silent, and the brain does not wait; q leaves, and tells what you have reached

a brain that waits longer for a person, and its teacher:
  mdb up --no-teacher --set optimizer.command_patience_s=20 --set optimizer.feedback_patience_s=5
  mdb teach --name ann
"""


def add(commands: Commands) -> None:
    """Add `teach`."""
    teach = commands.add_parser(
        "teach",
        help="teach a brain from this terminal",
        description="See the robot, play notes, reward and punish. Needs the extra 'teach' only.",
        epilog=TEACH_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    teach.add_argument("--connect", default=USUAL, help="the router's endpoint")
    add_keys(teach)
    teach.add_argument("--brain", help="the brain's name (as your keys say, or pioneer)")
    teach.add_argument("--name", help="your name among the teachers (as your keys say, or teacher)")
    teach.add_argument("--language", default="reversed", help="what your notes mean at the beginning (reversed)")
    teach.add_argument(
        "--suggest",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="begin with the hint on: which command would be right (on)",
    )
    teach.add_argument(
        "--auto", action="store_true", help="your notes are played by themselves, as a scripted teacher would"
    )
    teach.add_argument(
        "--experiment",
        type=experiment_path,
        metavar="FILE",
        help="the brain's file: what can be wanted, the scale of notes, how long the brain waits",
    )
    teach.add_argument("--sound", metavar="INSTRUMENT", help="play the notes instead of naming them, as in flute")
    teach.add_argument("--microphone", action="store_true", help="the brain hears your microphone (extra 'sound')")
    teach.set_defaults(command=_teach, extra="teach")


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
