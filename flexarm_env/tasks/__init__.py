"""Tasks of the environments: targets, observations, rewards, moving targets."""
