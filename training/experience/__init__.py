"""Collected episodes, and the buffers that batches are drawn from."""
