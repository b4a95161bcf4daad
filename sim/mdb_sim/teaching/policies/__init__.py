"""What teachers want: one file for the machines of a kind."""
