"""The contract that every engine meets, and how a plant may differ from its description."""
