"""Measured air: from a hygrometer's record to the statistics of its fluctuations, to pictures of them, and to a scene."""
