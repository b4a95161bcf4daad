"""Studies: many runs of variants of an experiment, measured into small tables. How they look is in `report`."""
