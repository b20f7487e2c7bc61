"""Networks: the encoder of observations, the actor, the critics and their compiled arithmetic."""
