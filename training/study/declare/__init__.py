"""The runs of the study, and the evaluations they need."""
