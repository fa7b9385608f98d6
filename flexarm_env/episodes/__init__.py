"""Play policies in environments, record the episodes, and measure them.

    from flexarm_env.episodes import History, measures, play
    history = History()
    play(env, policy, range(10_000, 10_000 + env.num_envs), [history])
    measures.returns(history), measures.settling_time(history, control.Setup.of(env))

`play` and its generator `periods` are the only loops that play episodes of policies. The suite, evaluation and tuning,
films, `flexarm play` and replays use these loops.
"""

from .history import History
from .loop import Actions, Instant, Policy, Timed, periods, play

__all__ = ["Actions", "History", "Instant", "Policy", "Timed", "periods", "play"]
