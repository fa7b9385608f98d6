"""Run policies in environments, record the episodes, and compute measures of the episodes.

    from flexarm_env.episodes import History, measures, play
    history = History()
    play(env, policy, range(10_000, 10_000 + env.num_envs), [history])
    measures.returns(history), measures.settling_time(history, control.Setup.of(env))

Suite, evaluation, tuning, films, `flexarm play` and replays run all policies with `play` or with the generator
`periods`, which `play` calls.
"""

from .history import History
from .loop import Actions, Instant, Policy, Timed, periods, play

__all__ = ["Actions", "History", "Instant", "Policy", "Timed", "periods", "play"]
