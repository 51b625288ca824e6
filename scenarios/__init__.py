"""Ready scenes; `thzcl scenarios` lists them."""
