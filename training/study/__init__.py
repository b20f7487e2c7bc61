"""The study: a declared grid of training runs, their evaluations, and the report."""
