"""`thzcl stress`: stiff and extreme cases, each run as any scene and held to a float64 truth."""
