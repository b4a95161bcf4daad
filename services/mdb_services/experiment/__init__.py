"""What an experiment file says of the brain."""
