"""From a scenario to the graph of specs that makes its images."""
