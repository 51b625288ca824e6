"""What accuracy costs: every knob turned on its own, error against run time."""
