"""`thzcl stress`: stiff and extreme cases, each run as any scenario is and held to a reference that no device computed."""

from thzcl.stress.cases import cases
from thzcl.stress.trial import Case, Outcome, examine

__all__ = ["Case", "Outcome", "cases", "examine"]
