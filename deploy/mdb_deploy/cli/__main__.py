"""`python -m mdb_deploy.cli` is `mdb`."""

import sys

from mdb_deploy.cli.main import main

sys.exit(main())
