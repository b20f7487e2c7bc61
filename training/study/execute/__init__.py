"""Carry out the runs of the study."""
