"""`thzcl stress`: stiff and extreme cases, run as any scene and compared with a float64 truth."""
