"""Controllers: what they see in, cable commands out."""
