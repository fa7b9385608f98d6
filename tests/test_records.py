"""Fields as data: validation, TOML, docstrings, tables and the JSON schema of arm files follow from one declaration."""

import argparse
import copy
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from typing import Any

import pytest
import tomli_w

from benchmarks import arm_page
from flexarm_env import Arm, Joint, Link, Motor, Payload, Scene, Section, arms, records, scenes
from flexarm_env.cli import main
from flexarm_env.files import from_json
from flexarm_env.settings import FORMULATIONS, Settings, default_options
from flexarm_env.training.arguments import parse
from flexarm_env.training.runs import Training
from tests.schema_tools import faults, own_faults

ENUMS = [name for name, rule in records.rules(Settings).items() if "enum" in rule.json]
STEEL = {"width": 0.03, "thickness": 0.003, "E": 7e10, "rho": 2700.0, "G": 2.6e10}


def file_of(**more: Any) -> dict[str, Any]:
    """Table of an arm's file with one link."""
    return {"name": "mine", "links": [{"length": 1.0, "section": STEEL}], **more}


def packaged() -> dict[str, dict[str, Any]]:
    """The tables of the packaged arms by name."""
    folder = resources.files("flexarm_env") / "data" / "arms"
    return {name: tomllib.loads((folder / f"{name}.toml").read_text("utf-8")) for name in arms.names()}


# ------------------------------------------------------------------ one new field
@records.described
@dataclass(frozen=True)
class SprungPayload(Payload):
    """A payload on a spring."""

    stiffness: float = records.number("stiffness of the spring", "N/m", 40.0, above=0.0, maximum=1e6)


def test_a_new_field_yields_validation_table_documentation_and_schema() -> None:
    made = records.made("payload", SprungPayload, {"mass": 1, "stiffness": 5}, prefix="")
    assert made.stiffness == 5.0 and isinstance(made.mass, float)
    rule = r"payload.stiffness = 0.0: must be a finite number, above 0 and at most 1e\+06 \(N/m\)"
    with pytest.raises(ValueError, match=rule):
        SprungPayload(stiffness=0.0)
    with pytest.raises(ValueError, match=r"payload.stifness: unknown key \(did you mean stiffness\?\)"):
        records.made("payload", SprungPayload, {"stifness": 5.0})
    assert "    stiffness: stiffness of the spring (N/m, positive, at most 1e+06)." in str(SprungPayload.__doc__)
    row = ("`stiffness`", "`40.0`", "N/m, positive, at most 1e+06", "stiffness of the spring")
    assert records.rows(SprungPayload) == [*records.rows(Payload), row]
    json = records.schema(SprungPayload)
    assert json["properties"]["stiffness"] == {
        "type": "number", "exclusiveMinimum": 0.0, "maximum": 1e6, "description": "stiffness of the spring (N/m)",
    }  # fmt: skip
    assert not faults({"stiffness": 5.0}, json) and faults({"stiffness": -5.0}, json)
    # a flag of the command line, with its help
    parser = argparse.ArgumentParser()
    records.add_flags(parser, SprungPayload)
    assert parser.parse_args(["--stiffness", "5"]).stiffness == 5.0 and parser.parse_args([]).stiffness is None
    assert "--stiffness X stiffness of the spring (N/m, positive, at most 1e+06)" in " ".join(
        parser.format_help().split()
    )


def test_a_new_field_of_a_training_run_is_a_flag_that_is_validated(capsys: pytest.CaptureFixture[str]) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Longer(Training):
        """A run with one more option."""

        pauses: int = records.integer("pauses between rollouts", 2, minimum=0, maximum=9)

    with pytest.raises(SystemExit):
        parse(Longer, "train", None, ["--help"])
    assert "pauses between rollouts (zero or positive, at most 9) (2)" in " ".join(capsys.readouterr().out.split())
    given = parse(Longer, "train", None, ["--pauses", "10"])
    with pytest.raises(ValueError, match=r"^--pauses = 10: must be a whole number, from 0 to 9"):
        given.begun()


def test_each_solver_option_is_a_flag_a_key_and_a_rule(capsys: pytest.CaptureFixture[str]) -> None:
    """From one declaration: a rejected value in Python and TOML, the schema of scenes, the help of `replay`."""
    with pytest.raises(SystemExit):
        main(["replay", "--help"])
    shown, schema = capsys.readouterr().out, Scene.schema()
    for name in records.rules(Settings):
        assert name == "newmark" or f"--{name.replace('_', '-')}" in shown
        check_option(name, schema)


def check_option(name: str, schema: dict[str, Any]) -> None:
    """A value that is wrong for a solver option is rejected everywhere."""
    formulation = next((f for f in FORMULATIONS if name in default_options(f)), "elastica")
    wrong = -1 if records.rules(Settings)[name].json["type" if name not in ENUMS else "enum"] != "boolean" else 2
    with pytest.raises(ValueError, match=rf"{name} = {wrong}: must be"):
        Settings.make(**{"formulation": formulation, name: wrong})
    table = tomllib.loads(scenes.named("flying_rod").to_toml())
    table["solver"] = {"formulation": formulation, name: wrong}
    assert any(path == f"solver.{name}" for path, _ in own_faults(table, schema))
    with pytest.raises(ValueError, match=name):
        Scene.from_toml(tomli_w.dumps(table)).settings()


def test_the_schema_of_scenes_accepts_the_packaged_scenes_and_rejects_faults() -> None:
    schema = Scene.schema()
    for name in scenes.names():
        table = tomllib.loads(scenes.named(name).to_toml())
        assert not list(own_faults(table, schema)), name
    table = tomllib.loads(scenes.named("flying_rod").to_toml())
    assert not faults(table, schema) and faults({**table, "dt": -1.0}, schema)
    for name in ("flying_rod", "robot_arm_motion"):
        table = tomllib.loads(scenes.named(name).to_toml())
        for key, value, path in (
            ("duration", 0.0, "duration"), ("root", "welded", "root"), ("solver", {"segmants": 3}, "solver"),
            ("motions", [{"kind": "ramp"}], "motions.0"), ("loads", [{"link": 0, "end": "middle"}], "loads.0.end"),
            ("loads", [{"joint": -1, "kind": "pulse"}], "loads.0.joint"), ("space", 1, "space"), ("grvity", [], ""),
            ("arm", {**table["arm"], "tau_d": -1.0}, "arm.tau_d"),
        ):  # fmt: skip
            assert any(place == path for place, _ in own_faults({**table, key: value}, schema)), (name, key)
            with pytest.raises(ValueError):
                Scene.from_toml(tomli_w.dumps({**table, key: value})).settings()


def test_records_have_the_messages_of_before() -> None:
    """Key path, value, rule and unit."""
    section = {"EI": 1.0, "EA": 1.0, "C": 1.0, "m": 1.0}
    for make, sentence in (
        (lambda: Section(**{**section, "EI": -1.0}), "section.EI = -1.0: must be a positive number (N m^2)"),
        (lambda: Section(**section, J_y=-1.0), "section.J_y = -1.0: must be a number, zero or positive (kg m)"),
        (lambda: Motor(1.0, back_emf=True), "motor.back_emf = True: must be a number, zero or positive (V s/rad)"),
        (lambda: Motor(1.0, voltage_limit=1.0), "motor.resistance: missing; a voltage does not determine the current"),
        (lambda: Joint(stiffness=0.0), "stiffness = 0.0: must be a positive number (N m/rad), or inf for a rigid gear"),
        (lambda: Joint(gear_ratio=2e9), "gear_ratio = 2000000000.0: must be a finite number, above 0 and at most"),
        (lambda: Joint(friction_side="rotor"), 'friction_side = \'rotor\': must be one of "motor", "link"'),
        (lambda: Payload(offset=(1.0,)), "payload.offset = (1.0,): must be a sequence of two numbers (m), along"),
        (lambda: Arm("a", (Link(1.0, Section(**section)),), tau_d=-1.0), "tau_d = -1.0: must be a number, zero or pos"),
        (lambda: arms.from_table(file_of(base={"mass": 1.0})), "base.inertia: missing; must be a positive number (kg"),
        (lambda: arms.from_table(file_of(joints=[{"motor": {}}])), "joints[0].motor.torque_constant: missing; must be"),
    ):  # fmt: skip
        with pytest.raises(ValueError) as error:
            make()
        assert str(error.value).startswith(sentence)


def test_the_tables_of_the_page_are_those_of_the_records() -> None:
    """`python -m benchmarks.arm_page` writes them."""
    for name, kinds in arm_page.PAGES.items():
        text = (arm_page.DOCS / f"{name}.md").read_text("utf-8")
        assert text == arm_page.page(name)
        assert all(f"| `{key}` |" in text for kind in kinds.values() for key in records.rules(kind))
    assert sum(len(records.rules(kind)) for kinds in arm_page.PAGES.values() for kind in kinds.values()) > 100


# ------------------------------------------------------------------ the schema of arm files
def test_the_schema_accepts_the_packaged_arms_and_what_the_package_writes() -> None:
    for name, table in packaged().items():
        assert not faults(table, arms.schema()), name
        assert not faults(tomllib.loads(arms.to_toml(arms.named(name))), arms.schema()), name
    assert not faults({"arm": file_of(), "identification": {}}, arms.schema())


@pytest.mark.parametrize("check", [faults, lambda value, schema: list(own_faults(value, schema))])
def test_the_schema_rejects_a_faulty_file_and_names_the_place(check: Any) -> None:
    link = {"length": 1.0, "section": STEEL}
    for table, path, words in (
        (file_of(links=[{**link, "section": {**STEEL, "E": -7e10}}]), "links.0.section.E", "minimum of 0"),
        (file_of(links=[{**link, "lenght": 1.0}]), "links.0", "'lenght' was unexpected"),
        (file_of(links=[{"section": STEEL}]), "links.0", "'length' is a required property"),
        (file_of(links=[{"length": 1.0, "mass": -1.0}]), "links.0.mass", "less than the minimum of 0"),
        (file_of(links=[{**link, "section": {"diameter": 0.1, "E": 1.0, "rho": 1.0}}]), "links.0.section", "'G' is a"),
        (file_of(links=[link, {**link, "section": [{"s": 0.0, **STEEL}, {**STEEL}]}]), "links.1.section.1", "'s' is a"),
        (file_of(payload={"mass": "heavy"}), "payload.mass", "'heavy' is not of type 'number'"),
        (file_of(joints=[{"friction_side": "rotor"}]), "joints.0.friction_side", "'rotor' is not one of"),
        (file_of(joints=[{"motor": {}}]), "joints.0.motor", "'torque_constant' is a required property"),
        (file_of(sensors={"strain_gauges": [{"plaice": 0.1}]}), "sensors.strain_gauges.0", "'plaice' was unexpected"),
        (file_of(sensors={"strain_gauges": [{"place": 2.0}]}), "sensors.strain_gauges.0.place", "the maximum of 1"),
        (file_of(sensors={"encoders": {"counts": 1.5}}), "sensors.encoders.counts", "1.5 is not of type 'integer'"),
        (file_of(sensors={"camera": {"low_pass": {}}}), "sensors.camera.low_pass", "'frequency' is a required prop"),
        ({"arm": file_of(tau_d=-1.0)}, "arm.tau_d", "-1.0 is less than the minimum of 0"),
        ({"name": "mine"}, "", "'links' is a required property"),
    ):  # fmt: skip
        found = check(table, arms.schema())
        assert len(found) >= 1 and found[0][0] == path and any(words in message for _, message in found), found
        with pytest.raises(ValueError):  # the reader rejects the file, too
            arms.from_table(table.get("arm", table))


def numbers_in(table: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all numbers in a table."""
    for key, one in table.items() if isinstance(table, dict) else enumerate(table):
        if isinstance(one, dict | list):
            yield from numbers_in(one, (*path, key))
        elif isinstance(one, int | float):
            yield (*path, key)


def test_the_reader_rejects_what_the_schema_rejects() -> None:
    """Each number of each packaged arm in turn is negated or becomes a text; the schema never asks for more."""
    rejected = 0
    for table in packaged().values():
        for path in numbers_in(table):
            for change in (lambda x: -x, str):
                other: Any = copy.deepcopy(table)
                place = other
                for key in path[:-1]:
                    place = place[key]
                place[path[-1]] = change(place[path[-1]])
                if list(own_faults(other, arms.schema())):
                    rejected += 1
                    with pytest.raises(ValueError):
                        arms.from_table(other)
    assert rejected > 100


def test_the_command_prints_the_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert from_json(capsys.readouterr().out, "schema") == arms.schema()
    assert main(["schema", "scene"]) == 0
    assert from_json(capsys.readouterr().out, "schema") == Scene.schema()
