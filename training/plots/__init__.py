"""Figures and videos of runs and policies."""
