"""The run log: one run, one HDF5 file, and every way in and out of it."""
