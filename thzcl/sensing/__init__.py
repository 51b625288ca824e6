"""From rays to what a sensor records."""
