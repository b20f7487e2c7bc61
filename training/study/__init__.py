"""The study: which runs there are, and what their numbers say."""
