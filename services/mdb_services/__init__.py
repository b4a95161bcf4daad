"""The services of the brain: memory store, evolvers, action optimizer, recorder."""
