"""What `agents.train_rllib` and `agents.sweep` are made of: Ray started, RLlib's PPO set up, runners, the network."""
