"""Scripts of a checkout, such as `python -m agents.train_ppo`: short programs around `flexarm_env.training`, and
studies.
"""
