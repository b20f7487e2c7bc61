"""Robots and trained policies that ship with cdcsr."""
