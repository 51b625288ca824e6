"""At what range a target is detected: observers, probabilities and their intervals."""
