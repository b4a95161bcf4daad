"""Short-term and long-term memory, and changes of context."""
