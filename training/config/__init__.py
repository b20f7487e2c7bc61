"""What a training run is, as plain data."""
