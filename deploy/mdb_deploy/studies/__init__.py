"""`mdb study` and `mdb acceptance`: sweeps over many seeds, and the reports of them."""
