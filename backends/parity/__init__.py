"""Measure how far apart engines are: at one state, after one step, and in open loop.

The engines are implementations of one model, so that their agreement verifies the implementations;
it is no evidence that the model describes a real robot.
"""
