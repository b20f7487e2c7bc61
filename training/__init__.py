"""Learning controllers from demonstrations and rewards, and measuring them in every engine."""
