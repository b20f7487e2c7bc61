"""Runs that learn side by side on one device, and never leave it: PyTorch's tensors throughout."""
