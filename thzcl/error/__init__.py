"""The error budget, which measures the errors of a run's images."""
