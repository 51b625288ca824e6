"""Scenarios: TOML in, checked and immutable scenes out, and every problem in words."""
