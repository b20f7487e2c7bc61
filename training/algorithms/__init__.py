"""Learning algorithms, one file each; a variant holds only what differs."""
