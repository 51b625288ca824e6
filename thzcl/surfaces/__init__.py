"""The surfaces that rays end on, the camera that the rays start from, and their radiance."""
