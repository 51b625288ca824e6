"""What a run found out: files and pictures."""
