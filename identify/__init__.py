"""Identification: zeta, lambda and other numbers of the simulator from recorded runs."""
