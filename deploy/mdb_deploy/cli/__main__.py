"""Where `mdb` begins, and `python -m mdb_deploy.cli`: sets apart what it inherits, then hands over to `main`."""

import os
import sys


def main() -> int:
    """Run the command line; return the exit status."""
    leave_out_this_folder()
    os.environ["PYTHONSAFEPATH"] = "1"  # what is started from here looks there neither
    os.environ.pop("MPLBACKEND", None)  # a notebook's: here figures are files
    from mdb_deploy.cli.main import main as run

    return run()


def leave_out_this_folder() -> None:
    """Import nothing from the working directory: a `random.py` there is none of ours.

    `python -m` looks there, and so does an empty word in PYTHONPATH, as in `$PYTHONPATH:/more`. A folder that
    PYTHONPATH names by its whole path stays; bodies and policies are found beside their experiment file.
    """
    here = os.getcwd()
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if here not in named and not os.path.isdir(os.path.join(here, "mdb_deploy")):
        sys.path[:] = [path for path in sys.path if os.path.abspath(path) != here]


if __name__ == "__main__":
    sys.exit(main())
