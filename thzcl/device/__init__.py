"""The OpenCL device, and all that knows of OpenCL."""
