"""What air absorbs: MPM93, humidity in its three forms, and polynomials that stand in for MPM93 in the kernels."""

from thzcl.absorption.air import Air
from thzcl.absorption.mpm93 import Attenuation, attenuation
from thzcl.absorption.surrogate import Surrogate, fit

__all__ = ["Air", "Attenuation", "Surrogate", "attenuation", "fit"]
