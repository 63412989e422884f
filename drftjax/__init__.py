"""Dynamic resistive force theory for rover wheels on sand, on JAX."""

__version__ = "0.1.0"
