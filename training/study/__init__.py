"""The study: a declared grid of training runs and their evaluations, carried out on this machine or on a cluster."""
