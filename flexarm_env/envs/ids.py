"""Validate environment ids in files, so that a policy or recording cannot import arbitrary code."""

from collections.abc import Callable
from typing import Any

from gymnasium.envs.registration import registry
from gymnasium.error import DependencyNotInstalled, Error

from .. import validation as check
from .options import ARGUMENTS

PACKAGE = "flexarm_env"


def own_ids() -> tuple[str, ...]:
    """Return the ids of this package's registered environments that simulate an arm."""
    return tuple(key for key, spec in registry.items() if str(spec.entry_point).startswith(f"{PACKAGE}.envs."))


def make_registered(make: Callable[..., Any], env_id: str, /, **keywords: Any) -> Any:
    """Call `make`, a function such as `gymnasium.make`, with an id; raise ValueError if the id is not registered."""
    try:
        return make(env_id, **keywords)
    except DependencyNotInstalled:
        raise
    except Error:
        raise check.UnknownKey(env_id, own_ids(), "environment") from None


def permitted(path: str, env_id: Any, env_kwargs: Any, named: str | None = None) -> tuple[str, dict[str, Any]]:
    """Validate the environment id and the keywords in a file, and return both.

    Args:
        path: key path of the id in error messages. named: id that the user has given; this id is permitted even if it
            belongs to another package.
    Raises:
        ValueError: the id belongs to another package and differs from `named`, or an id of this package has unknown
            keywords.
    """
    keywords = check.table_of(check.joined(path, "env_kwargs"), env_kwargs)
    if named is not None and env_id == named:
        return named, keywords
    if not isinstance(env_id, str) or env_id.removeprefix(f"{PACKAGE}:") not in own_ids():
        what = f"must be {' or '.join(own_ids())}: the caller must also name an environment of another package"
        raise check.InvalidValue(check.joined(path, "env_id"), env_id, what)
    taken = [name for name in ARGUMENTS if name != "render_mode"]
    check.known_keys(check.joined(path, "env_kwargs"), keywords, taken, "argument")
    return env_id, keywords
