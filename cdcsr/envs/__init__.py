"""Gymnasium environments over any engine."""
