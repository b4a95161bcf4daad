"""What goes on now, for browsers: the brain heard once for all of them, and what they may do in it."""
