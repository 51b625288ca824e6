"""The results of a run, their files and pictures."""
