"""Parts of `agents.train_rllib` and `agents.sweep`: start of Ray, setup of RLlib's PPO, runners, and the network."""
