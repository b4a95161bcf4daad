"""What is said of studies: statistics, criteria, tables and figures. Nothing here changes what a run does."""
