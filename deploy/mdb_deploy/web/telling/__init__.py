"""What a run is, told in plain JSON values, from its messages alone: for the page, live and afterwards."""
