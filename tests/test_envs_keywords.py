"""Signatures of the environments: every keyword has a name, a type and a default."""

import inspect
from typing import Any, get_type_hints

import pytest

from flexarm_env.envs.flexible_arm import FlexibleArmEnv, FlexibleArmVectorEnv
from flexarm_env.envs.keywords import Keywords, SolverKeywords
from flexarm_env.envs.options import ARGUMENTS, plan
from flexarm_env.envs.spatial import SpatialFlexArmEnv
from flexarm_env.settings import Settings


def test_the_typed_keywords_are_those_that_are_checked() -> None:
    """Names and types of `Keywords` are those of `plan`, and of `Settings` for the solver's options."""
    typed = get_type_hints(Keywords)
    assert set(typed) == set(ARGUMENTS)
    own, solver = get_type_hints(plan), get_type_hints(Settings)
    for name, type_ in typed.items():
        assert type_ == (solver[name] | None if name in SolverKeywords.__annotations__ else own[name]), name


@pytest.mark.parametrize("kind", [FlexibleArmEnv, FlexibleArmVectorEnv, SpatialFlexArmEnv])
def test_signatures_name_every_keyword(kind: Any) -> None:
    """`help` and completion show each keyword with its default, which is the one in use."""
    parameters = inspect.signature(kind).parameters
    assert not [p for p in parameters.values() if p.kind is p.VAR_KEYWORD]
    assert set(ARGUMENTS) <= set(parameters)
    assert all(p.default is not p.empty for p in parameters.values())
    taken = inspect.signature(plan).parameters
    for name in set(ARGUMENTS) & set(taken):
        assert parameters[name].default is taken[name].default
    if "num_envs" in parameters:
        assert (parameters["num_envs"].default, parameters["threads"].default) == (1, None)
