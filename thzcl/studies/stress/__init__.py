"""`thzcl stress`: stiff and extreme cases.

Each run as any scenario is and held to a reference that no device computed.
"""

from thzcl.studies.stress.cases import cases
from thzcl.studies.stress.trial import Case, Outcome, examine

__all__ = ["Case", "Outcome", "cases", "examine"]
