"""What every service has around its `step`, and what the wire has in common with the mechanism."""
