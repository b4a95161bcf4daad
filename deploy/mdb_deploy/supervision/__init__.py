"""The processes of a brain: which there are, what each is, started and watched."""
