"""Scripts of a checkout, such as `python -m agents.train_ppo`: short programs that call `flexarm_env.training`, and
studies of the suite and of controllers.
"""
