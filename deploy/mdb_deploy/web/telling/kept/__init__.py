"""What is kept of a run to tell it, bounded: rows, languages, models, memories, newest messages, a log's index."""
