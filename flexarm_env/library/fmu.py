"""An arm as a functional mock-up unit: co-simulation by FMI 2.0 or 3.0, around the library."""

from __future__ import annotations

import hashlib
import io
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from .. import validation as check
from ..files import write_whole
from ..physics.layout import POSES
from ..tasks.program import ENERGIES, INFO
from .build import Built, linked, write
from .source import VERSION, flat, number

FORMS = {"2.0": "linux64", "3.0": "x86_64-linux"}
"""Versions of the standard that are written, and what they call Linux on x86-64."""

UNITS: dict[str, dict[str, int]] = {
    "m": {"m": 1}, "s": {"s": 1}, "kg": {"kg": 1}, "rad": {"rad": 1}, "m/s": {"m": 1, "s": -1},
    "rad/s": {"rad": 1, "s": -1}, "kg m2": {"kg": 1, "m": 2}, "J": {"kg": 1, "m": 2, "s": -2},
    "N m": {"kg": 1, "m": 2, "s": -2},
}  # fmt: skip
"""In the base units of SI."""

LEFT_OUT = ("target", "terms", "reason", "reward", "truncated", "further")
"""Of what is told of an arm: the task's, and what fails a step here."""


class Variable(NamedTuple):
    """A number of the unit. kind, at: as in `fmu.c`. start: None where it is computed."""

    name: str
    kind: str
    at: int
    unit: str
    meaning: str
    start: float | int | None = None

    @property
    def causality(self) -> str:
        """As the standard calls it."""
        return {"INPUT": "input", "TIME": "independent"}.get(self.kind, "output" if self.start is None else "parameter")


def write_fmu(env: Any, path: Path, name: str, form: str = "3.0", cpu: str | None = None) -> Built:
    """The arm of an environment with its motors as a co-simulation unit; see `build.write`.

    Torques (or actions, where they are something else) act through whole control periods, of which a communication step
    is a whole number. Where the arm starts and what its parameters are is set, not drawn; noise follows from `seed`.
    States can be kept and put back; directional derivatives are the library's, and not in the unit.

    Args:
        path: of the file. form: version of the standard, a key of `FORMS`.
    Raises:
        ValueError: as `build.write`; no C compiler is there.
    """
    if form not in FORMS:
        raise check.InvalidValue("form", form, f"must be {' or '.join(FORMS)}")
    with tempfile.TemporaryDirectory() as folder:
        built = write(env, Path(folder), name, cpu, derivatives=False)
        if built.library is None:
            raise ValueError(f"{path}: a unit holds machine code: {built.why}")
        source, plan = built.source, env.unwrapped.plan
        variables = list(_variables(source, plan))
        token = hashlib.sha256(source.files()[f"{name}.c"].encode()).hexdigest()[:32]
        first, aim = (
            ", ".join(number(one.start or 0.0) for one in variables if one.kind == kind)
            for kind in ("PARAMETER", "TARGET")
        )
        text = source.filled(
            "fmu.c", TOKEN=token, PARAMETERS=first, AIM=aim,
            VARIABLES="\n".join(f"    {{{one.kind}, {one.at}}}," for one in variables),
            STEP=f"{name}_step_torques" if plan.action_mode == "torque" else f"{name}_step",
        )  # fmt: skip
        (Path(folder) / "fmu.c").write_text(text)
        code, _ = linked(Path(folder), f"{name}.so", ["fmu.c", f"{name}.c", *built.objects])
        binary = (Path(folder) / str(code)).read_bytes()
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as unit:
        unit.writestr("modelDescription.xml", _description(name, token, form, plan, variables))
        unit.writestr(f"binaries/{FORMS[form]}/{name}.so", binary)
    write_whole(path, held.getvalue())
    return built


def _variables(source: Any, plan: Any) -> Iterator[Variable]:
    """All of them; a variable's value reference is its place."""
    joints, batch = range(plan.arm.n_links), source.batch
    yield Variable("time", "TIME", 0, "s", "since the start")
    torque = plan.action_mode == "torque"
    for k in joints:
        what = "asked of the motor, through a period" if torque else f'action_mode "{plan.action_mode}", within +-1'
        yield Variable(f"{'torque' if torque else 'action'}[{k}]", "INPUT", k, "N m" if torque else "", what, 0.0)
    own = zip(("payload_mass", "payload_inertia", "EI_factor", "tau_d"), ("kg", "kg m2", "", "s"), strict=True)
    for k, (word, unit) in enumerate(own):
        yield Variable(word, "PARAMETER", k, unit, "of the arm, tunable", float(batch.system.par[k]))
    for k in joints:
        yield Variable(f"start_angle[{k}]", "ANGLE", k, "rad", "of the joint, at the start", 0.0)
    length, point = plan.arm.total_length, len(batch.task.targets) > 1
    for k, value in enumerate((0.6 * length, 0.3 * length) if point else (0.5,)):
        yield Variable(f"target[{k}]", "TARGET", k, "m" if point else "rad", "of the task", value)
    yield Variable("start_vibration", "VIBRATION", 0, "", "tip deflection over the arm's length, at the start", 0.0)
    yield Variable("seed", "SEED", 0, "", "that sensor noise follows from", 0)
    at = 0
    for field, shape in zip(INFO.fields, INFO.shapes(**source.sizes), strict=True):
        for word, unit, meaning in _told(field, shape):
            if field.name not in LEFT_OUT:
                yield Variable(word, "INFO", at, unit, meaning)
            at += 1
    for link in joints:
        for k, field in enumerate(POSES.fields):
            where = "tip" if field.name.startswith("tip_") else "root"
            word = field.name.removeprefix("tip_")
            unit = {"angle": "rad", "rate": "rad/s"}.get(word, "m/s" if word.startswith("v") else "m")
            place = len(POSES.fields) * link + k
            yield Variable(f"link[{link}].{where}_{word}", "POSE", place, unit, f"of link {link}'s {where}")
    setup = source.setup
    for k in range(setup.size):
        instant, entry = divmod(k, len(setup.names))
        past, scale = "" if setup.history == 1 else f"[{instant}]", setup.scales[entry]
        what = f"read by the sensors, over {scale:.9g}"
        yield Variable(f"observation{past}.{setup.names[entry]}", "OBSERVATION", k, "", what)


def _told(field: Any, shape: tuple[int, ...]) -> Iterator[tuple[str, str, str]]:
    """Name, unit and meaning of the numbers of an entry of info."""
    unit, meaning = field.unit if field.unit in UNITS else "", field.meaning.replace("`", "")
    if field.name == "energies":
        yield from ((f"energy.{one.name}", one.unit, one.meaning) for one in ENERGIES.fields)
    elif field.name == "motors":
        for word, own in (("angle", "rad"), ("rate", "rad/s")):
            yield from ((f"motor_{word}[{k}]", own, "of the motor, after the ratio") for k in range(shape[1]))
    else:
        name, shape = "applied_torque" if field.name == "torque" else field.name, flat(shape)
        yield from ((f"{name}[{k}]", unit, meaning) for k in range(shape[0])) if shape else [(name, unit, meaning)]


def _description(name: str, token: str, form: str, plan: Any, variables: list[Variable]) -> bytes:
    """modelDescription.xml."""
    new = form == "3.0"
    tree = ElementTree.Element("fmiModelDescription", {
        "fmiVersion": form, "modelName": name, "instantiationToken" if new else "guid": token,
        "description": "a flexible-link robot arm", "generationTool": f"flexarm_env {VERSION}",
        "variableNamingConvention": "flat",
    })  # fmt: skip
    states = "State" if new else "state"
    how = {
        "modelIdentifier": name, "canHandleVariableCommunicationStepSize": "true",
        f"canGetAndSetFMU{states}": "true", f"canSerializeFMU{states}": "true",
    }  # fmt: skip
    if new:
        how["fixedInternalStepSize"] = number(plan.period)
    ElementTree.SubElement(tree, "CoSimulation", how)
    units = ElementTree.SubElement(tree, "UnitDefinitions")
    for unit, base in UNITS.items():
        found = ElementTree.SubElement(units, "Unit", name=unit)
        ElementTree.SubElement(found, "BaseUnit", {key: str(power) for key, power in base.items()})
    ElementTree.SubElement(
        tree, "DefaultExperiment", startTime="0", stopTime=number(plan.duration), stepSize=number(plan.period)
    )
    listed = ElementTree.SubElement(tree, "ModelVariables")
    for k, one in enumerate(variables):
        about = {"name": one.name, "valueReference": str(k), "description": one.meaning, "causality": one.causality}
        whole = isinstance(one.start, int)
        kinds = {"parameter": "tunable" if one.kind == "PARAMETER" else "fixed", "input": "continuous"}
        about["variability"] = kinds.get(one.causality, "continuous")
        value = {} if one.start is None else {"start": str(one.start)}
        if one.unit:
            value["unit"] = one.unit
        if new:
            ElementTree.SubElement(listed, "Int32" if whole else "Float64", about | value)
        else:
            if one.causality == "parameter":
                about["initial"] = "exact"
            found = ElementTree.SubElement(listed, "ScalarVariable", about)
            ElementTree.SubElement(found, "Integer" if whole else "Real", value)
    shape = ElementTree.SubElement(tree, "ModelStructure")
    out = [k for k, one in enumerate(variables) if one.causality == "output"]
    if new:
        for kind in ("Output", "InitialUnknown"):
            for k in out:
                ElementTree.SubElement(shape, kind, valueReference=str(k))
    else:
        for kind in ("Outputs", "InitialUnknowns"):
            group = ElementTree.SubElement(shape, kind)
            for k in out:
                ElementTree.SubElement(group, "Unknown", index=str(k + 1))
    ElementTree.indent(tree)
    text: bytes = ElementTree.tostring(tree, encoding="utf-8", xml_declaration=True)
    return text
