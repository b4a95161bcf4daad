"""Where `mdb` begins, and `python -m mdb_deploy.cli`: sets apart what it inherits, then hands over to `main`."""

import os
import sys

KERNELS = {"NUMBA_CACHE_DIR", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"}
"""Numba's settings that say where, and for which processors, kernels are kept."""


def main() -> int:
    """Run the command line; return the exit status."""
    open_what_is_closed()
    leave_out_this_folder()
    os.environ["PYTHONSAFEPATH"] = "1"  # what is started from here looks there neither
    os.environ.pop("PYTHONINSPECT", None)  # otherwise each service waits for words at its end
    os.environ.pop("MPLBACKEND", None)  # a notebook's: here figures are files
    for name in [name for name in os.environ if name.startswith("NUMBA_") and name not in KERNELS]:
        del os.environ[name]  # of another program's debugging: some stop the kernels' compiler
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in compose.yaml; threads take 0.1 s to start
    from mdb_deploy.cli.main import main as run

    return run()


def open_what_is_closed() -> None:
    """Let standard streams that somebody has closed (`mdb up >&-`) lead nowhere.

    Otherwise the next file that is opened takes the place of one, and what a library prints goes into that file.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w" if number else "r", encoding="utf-8"))  # noqa: SIM115


def leave_out_this_folder() -> None:
    """Import nothing from the working directory: a `random.py` there is none of ours.

    `python -m` looks there, and so does an empty word in PYTHONPATH, as in `$PYTHONPATH:/more`. A folder that
    PYTHONPATH names by its whole path stays; bodies and policies are found beside their experiment file.
    """
    try:
        here = os.getcwd()
    except OSError:  # deleted: nothing is in it
        return
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if here not in named and not os.path.isdir(os.path.join(here, "mdb_deploy")):
        sys.path[:] = [path for path in sys.path if os.path.abspath(path) != here]


if __name__ == "__main__":
    sys.exit(main())
