"""Absorption of moist air, measures of humidity, and radiometry."""
