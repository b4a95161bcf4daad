"""What `mdb init` writes: an experiment that runs, with what it needs beside it, and comments that teach."""
