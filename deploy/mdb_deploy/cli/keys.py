"""`mdb keys`: the key table and the messages; the key folder for a router that listens beyond this machine."""

from __future__ import annotations

import argparse
import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from mdb_deploy.cli.options import number
from mdb_deploy.cli.parsing import nearest
from mdb_protocol.errors import MdbError

if TYPE_CHECKING:
    from mdb_deploy.keys.credentials import KeyFolder

BRAIN = "brain"
ROLES = (BRAIN, "teacher", "viewer", "operator")
"""As `mdb_protocol.roles.Role`, which is not imported for a help text."""
KEYS = Path("keys")
DESCRIPTION = """\
Without a verb: prints the key table; roles, schema and duties print who may do what, what the messages are, and what
a robot owes. The other verbs make certificates and access control, for a router that other machines can reach. One
folder serves one router; its authority's key (ca-key.pem) never leaves it.
"""
EPILOG = """\
a teacher on another machine:
  mdb keys init --host 192.168.1.5             once; the names and addresses by which others reach this machine
  mdb up --listen tls/0.0.0.0:7447 --keys keys
  mdb keys add-teacher anna                    then carry keys/teachers/anna.pem to her, in private
"""


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `keys` and its verbs to the command line."""
    keys = commands.add_parser(
        "keys",
        help="print the key table; make certificates for teachers on other machines",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    keys.set_defaults(command=_table)
    verbs = keys.add_subparsers(metavar="VERB")
    roles = verbs.add_parser("roles", help="print who may write and read what")
    roles.set_defaults(command=_roles)
    duties = verbs.add_parser("duties", help="print what a robot over the wire owes")
    duties.set_defaults(command=_duties)
    schema = verbs.add_parser("schema", help="print the JSON Schema of the messages, or of one")
    schema.add_argument("message", nargs="?", metavar="MESSAGE", help="as in the key table (all, in one document)")
    schema.set_defaults(command=_schema)
    init = verbs.add_parser("init", help="make a key folder: authority, router, brain, access control")
    init.add_argument("keys", type=Path, nargs="?", default=KEYS, metavar="DIR", help="the folder to make (keys)")
    init.add_argument("--brain", default="pioneer", help="the brain's name (pioneer)")
    _add_hosts(init)
    init.set_defaults(command=_init)
    for role in ROLES:
        _add_user(verbs, role)
    remove = verbs.add_parser("remove", help="admit a teacher or viewer no longer")
    remove.add_argument("name", metavar="NAME")
    remove.set_defaults(command=_remove)
    listing = verbs.add_parser("list", help="who is admitted, and until when")
    listing.set_defaults(command=_list)
    renew = verbs.add_parser("renew", help="new certificates for router and brain, access control anew")
    _add_hosts(renew)
    renew.set_defaults(command=_renew)
    for verb in (remove, listing, renew):
        _add_folder(verb)


def _add_folder(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--keys", type=Path, default=KEYS, metavar="DIR", help="the key folder (keys)")


def _add_hosts(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--host",
        action="append",
        default=[],
        metavar="NAME_OR_ADDRESS",
        help="by which clients reach the router, besides localhost and this machine's name; may be given again",
    )


def _add_user(verbs: argparse._SubParsersAction[argparse.ArgumentParser], role: str) -> None:
    verb = verbs.add_parser(f"add-{role}", help=f"admit one more {role}: makes a bundle")
    verb.add_argument("name", metavar="NAME")
    _add_folder(verb)
    if role != BRAIN:
        verb.add_argument("--brain", help="of which brain; not needed when there is one")
        verb.add_argument(
            "--days", type=number(1, 36500), default=365, help="how long the certificate is valid (365)"
        )
    verb.set_defaults(command=_add, role=role)


def _folder(path: Path) -> KeyFolder:
    from mdb_deploy.keys.credentials import KeyFolder

    return KeyFolder(path)


def _table(_: argparse.Namespace) -> int:
    from mdb_protocol.keys import table

    sys.stdout.write(table() + "\n")
    return 0


def _roles(_: argparse.Namespace) -> int:
    from mdb_protocol.roles import table

    sys.stdout.write(table() + "\n")
    return 0


def _duties(_: argparse.Namespace) -> int:
    from mdb_protocol.duties import table

    sys.stdout.write(table() + "\n")
    return 0


def _schema(arguments: argparse.Namespace) -> int:
    from mdb_protocol.schema import document, every_type, schema_of

    named = {message.__name__: message for message in every_type()}
    if arguments.message is None:
        found = document()
    elif arguments.message in named:
        found = schema_of(named[arguments.message])
    else:
        near = nearest(arguments.message, list(named))
        raise MdbError(f"no message {arguments.message!r}{near}; there are {', '.join(sorted(named))}")
    sys.stdout.write(json.dumps(found, indent=1) + "\n")
    return 0


def _init(arguments: argparse.Namespace) -> int:
    from mdb_deploy.keys.credentials import AUTHORITY_DAYS, CERTIFICATE_DAYS, KeyFolder

    folder = KeyFolder.create(arguments.keys, arguments.brain, arguments.host)
    sys.stdout.write(
        f"{folder.path}: authority for {AUTHORITY_DAYS} days, router and brain {arguments.brain} for "
        f"{CERTIFICATE_DAYS}; 'mdb keys renew' makes the latter anew. Keep the folder to yourself.\n"
    )
    return 0


def _add(arguments: argparse.Namespace) -> int:
    from mdb_protocol.roles import Role

    folder, role = _folder(arguments.keys), Role(arguments.role)
    if role is Role.BRAIN:
        path = folder.add(role, arguments.name, arguments.name)
    else:
        path = folder.add(role, arguments.name, arguments.brain, arguments.days)
    sys.stdout.write(f"{path}\n")
    return 0


def _remove(arguments: argparse.Namespace) -> int:
    user = _folder(arguments.keys).remove(arguments.name)
    sys.stdout.write(f"{user} is no longer admitted\n")
    return 0


def _renew(arguments: argparse.Namespace) -> int:
    _folder(arguments.keys).renew(arguments.host)
    sys.stdout.write("router and brain have new certificates; those of teachers and viewers stay as they are\n")
    return 0


def _list(arguments: argparse.Namespace) -> int:
    folder = _folder(arguments.keys)
    for user in folder.users().values():
        sys.stdout.write(f"{user}, {_until(folder.bundle(user))}\n")
    return 0


def _until(path: Path) -> str:
    from mdb_protocol.bundle import Bundle

    if not path.exists():
        return "admitted, but its bundle is not here"
    until = Bundle.read(path).until
    ended = until is not None and until < datetime.now(UTC)
    return f"{'ended' if ended else 'until'} {until:%Y-%m-%d}: {path}" if until else str(path)
