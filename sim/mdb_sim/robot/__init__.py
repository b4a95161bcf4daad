"""The robot as a service, around any body."""
