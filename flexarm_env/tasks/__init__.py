"""What is asked of an arm: targets, observations, rewards, moving targets."""
