"""Which action is taken: what can be done at all, what is foreseen of it, and what is chosen."""
