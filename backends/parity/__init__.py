"""How far apart engines are: one state, one step, the same commands without feedback."""
