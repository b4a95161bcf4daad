"""The command line, the process table and its runner."""
