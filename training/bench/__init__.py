"""The measurements of `cdcsr bench`."""
