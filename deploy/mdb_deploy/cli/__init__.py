"""The command line `mdb`: one file a command."""
