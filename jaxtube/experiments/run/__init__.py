"""What the commands share: the folder of a run, its records, its metrics and tables."""
