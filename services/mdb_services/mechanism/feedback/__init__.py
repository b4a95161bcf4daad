"""What a feedback counts, and for which action it is."""
