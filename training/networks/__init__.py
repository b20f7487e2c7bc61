"""Actors, critics and their encodings."""
