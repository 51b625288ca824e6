"""Measured air: a hygrometer's record becomes statistics of its fluctuations, pictures, a scene."""
