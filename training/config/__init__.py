"""The description of a training run and the numbers that learners share, as plain data."""
