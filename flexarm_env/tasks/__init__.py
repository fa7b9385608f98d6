"""Compiled parts of the environments' tasks: targets, observations, rewards, and moving targets."""

RESIDUAL_SHARE = 0.7
"""Default share of the torque limit that the action adds in action_mode="residual_pd"."""
