"""The pure part of the brain: networks, evolution, memories, choice of action (arrays in, arrays out)."""
