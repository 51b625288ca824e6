"""Measured air: from a hygrometer's record to the statistics of its fluctuations.

To pictures of them, and to a scene.
"""
