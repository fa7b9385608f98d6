"""Training and judging of controllers, from a checkout: `python -m agents.train_ppo`, `python -m agents.evaluate`."""
