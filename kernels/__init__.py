"""The OpenCL C kernels: short entries over small physics functions."""
