"""`mdb teach`: a person teaches a brain from a terminal. Imports nothing beyond the extra `teach`."""
