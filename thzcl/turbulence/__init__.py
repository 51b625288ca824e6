"""Fluctuations of humidity and temperature on a cube of voxels."""
