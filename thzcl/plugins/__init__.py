"""Other people's code: found, loaded and guarded."""
