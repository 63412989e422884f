"""Dynamic resistive force theory for rover wheels on sand, on JAX."""
