"""Scripts of a checkout: `python -m agents.train_ppo` and others, thin over `flexarm_env.training`, and studies."""
