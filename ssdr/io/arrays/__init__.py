"""NumPy archives and arrays, and zarr stores."""
