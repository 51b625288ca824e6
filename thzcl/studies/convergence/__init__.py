"""What accuracy costs: every knob turned on its own, error against run time."""

from thzcl.studies.convergence.study import Point, study

__all__ = ["Point", "study"]
