"""Which runs the study has, and which evaluations of them."""
