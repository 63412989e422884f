"""Diagnosis: which effect that the model lacks explains a rig's gap, `drftjax.diagnose`."""
