"""Engines: each folder turns a Robot into that engine's model and puts the Simulation contract on top."""
