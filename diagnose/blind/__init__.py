"""Blind sets: runs of a rig whose faults are drawn by lot and sealed, to judge a diagnosis by."""
