"""Write an arm or a controller as a co-simulation FMU (FMI 2.0 or 3.0) that contains the C library."""

import hashlib
import io
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from .. import validation as check
from ..control.base import Controller, Setup
from ..control.export import check_name
from ..control.in_c import Pairs, Points, controller_source
from ..files import write_whole
from ..physics.reading import reading_of
from ..tasks.program import ENERGIES, INFO
from .build import Built, linked, write
from .source import VERSION, fill, flat, number

FORMS = {"2.0": "linux64", "3.0": "x86_64-linux"}
"""Supported versions of the FMI standard, each with the name of an FMU's folder for Linux on x86-64."""

UNITS: dict[str, dict[str, int]] = {
    "m": {"m": 1}, "s": {"s": 1}, "kg": {"kg": 1}, "rad": {"rad": 1}, "m/s": {"m": 1, "s": -1},
    "rad/s": {"rad": 1, "s": -1}, "kg m2": {"kg": 1, "m": 2}, "J": {"kg": 1, "m": 2, "s": -2},
    "N m": {"kg": 1, "m": 2, "s": -2}, "N m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "N m s/rad": {"kg": 1, "m": 2, "s": -1, "rad": -1},
}  # fmt: skip
"""Units of the FMU's variables, each with the exponents of the SI base units."""

UNIT = "co-simulation.c"
"""File name of the FMU's C source. The name is not a C identifier and therefore cannot collide with the library's
files."""

LEFT_OUT = ("target", "terms", "reason", "reward", "truncated", "further")
"""Entries of `info` that the FMU does not export: the task's entries, and the status, which an FMU reports by a failed
step.
"""


class Variable(NamedTuple):
    """One variable of an FMU: input, output, parameter or time.

    kind: name of the array in the C source `fmu.c` that contains the variable. at: index of the variable in this array.
    start: initial value, or None if the variable is computed. least, most: bounds of an input or parameter.
    """

    name: str
    kind: str
    at: int
    unit: str
    meaning: str
    start: float | int | None = None
    least: float = -check.LARGEST
    most: float = check.LARGEST

    @property
    def causality(self) -> str:
        """Causality of the variable in the FMI standard: "input", "output", "parameter" or "independent"."""
        # a variable with a start value is a parameter, one without is computed
        return {"INPUT": "input", "TIME": "independent"}.get(self.kind, "output" if self.start is None else "parameter")


def write_fmu(env: Any, path: Path, name: str, form: str = "3.0", cpu: str | None = None) -> Built:
    """Write an environment's arm with its motors as a co-simulation FMU.

    Inputs are the joint torques (N m), or the actions if the environment has another action mode. The inputs are
    constant over a control period. A communication step must be a whole number of control periods. The importing tool
    sets the initial state and the parameters. Only sensor noise is random; its seed is the parameter `seed`. The state
    of the FMU can be saved and restored. The FMU does not provide directional derivatives; the C library
    (`build.write`) does.

    Args:
        env: single environment of this package. path: path of the file. name: C identifier, name of the model. form:
            version of the FMI standard, a key of `FORMS`. cpu: LLVM's name of the processor, or None for `build.CPU`.
    Raises:
        ValueError: `build.write` raises it, or no C compiler is found.
    """
    _check_form(form)
    with tempfile.TemporaryDirectory() as folder:
        built = write(env, Path(folder), name, cpu, derivatives=False)
        if built.library is None:
            raise ValueError(f"{path}: a unit holds machine code: {built.why}")
        source, plan = built.source, env.unwrapped.plan
        variables = list(_variables(source, plan))
        first, aim = (
            ", ".join(number(one.start or 0.0) for one in variables if one.kind == kind)
            for kind in ("PARAMETER", "TARGET")
        )
        step = f"{name}_step_torques" if plan.action_mode == "torque" else f"{name}_step"
        part = source.filled("fmu_arm.c", PARAMETERS=first, AIM=aim, STEP=step)
        about = _About(name, form, "a flexible-link robot arm", plan.period, plan.duration)
        files = [Path(folder) / word for word in (f"{name}.h", f"{name}.c", *built.objects)]
        _pack(path, about, variables, part, f"{name}.h", source.files()[f"{name}.c"], files)
    return built


def write_controller_fmu(
    controller: Controller, path: Path, name: str, form: str = "3.0",
    slew: float | None = None, elbows: Pairs | None = None, targets: Points | None = None,
) -> None:  # fmt: skip
    """Write a controller as a co-simulation FMU with sensor readings as inputs and torques (N m) as outputs.

    Connect the inputs to the outputs of an arm's FMU. In a communication step the controller acts once per control
    period, each time on the readings at the start of the communication step. The outputs are the torques of the last
    control period. The importing tool must step the controller before the arm.

    Args:
        controller, slew, elbows, targets: arguments of `control.in_c.controller_source`. path, form: arguments of
            `write_fmu`.
    Raises:
        ValueError: `controller_source` does not support the controller, or no C compiler is found.
    """
    _check_form(form)
    check_name(name)
    code, setup = controller_source(controller, name, slew, elbows, targets), controller.setup
    variables = [Variable("time", "TIME", 0, "s", "since the start")]
    for k in range(setup.size):
        variables.append(Variable(*_observation_variable(setup, k), 0.0)._replace(kind="INPUT"))
    for k in range(setup.n_joints):
        variables.append(Variable(f"torque[{k}]", "INFO", k, "N m", "of the motor, through a period"))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.c"
        file.write_text(code)
        what = f"{type(controller).__name__}, a controller of a flexible-link robot arm"
        about = _About(name, form, what, setup.control_dt, 1.0)
        _pack(path, about, variables, fill("fmu_controller.c", name, {}), file.name, code, [file])


class _About(NamedTuple):
    """Attributes of an FMU's model description: name, FMI version, description, control period (s), stop time (s)."""

    name: str
    form: str
    what: str
    period: float
    stop: float


def _check_form(form: str) -> None:
    """Raise InvalidValue unless `form` is a supported FMI version."""
    if form not in FORMS:
        raise check.InvalidValue("form", form, f"must be {' or '.join(FORMS)}")


def _pack(
    path: Path, about: _About, variables: list[Variable], part: str, inside: str, code: str, files: list[Path]
) -> None:
    """Compile the FMU's C source in the folder of `files`, and zip it with the model description to `path`.

    part: C text with the types and functions of the arm or controller. inside: name of the file that the C source
        includes and that is not compiled separately. code: C text whose hash is the FMU's token, by which FMI
        identifies the unit.
    """
    name, folder = about.name, files[0].parent
    token = hashlib.sha256(code.encode()).hexdigest()[:32]
    types, functions = part.split("/* --- */\n")
    # C table of the variables: kind, index, bounds, name
    rows = "\n".join(
        f'    {{{one.kind}, {one.at}, {number(one.least)}, {number(one.most)}, "{one.name}"}},' for one in variables
    )
    text = fill("fmu.c", name, {
        "INSIDE": inside, "TYPES": types, "FUNCTIONS": functions, "TOKEN": token, "VARIABLES": rows,
        "PERIOD": repr(about.period),
    })  # fmt: skip
    (folder / UNIT).write_text(text)
    code_file, why = linked(folder, f"{name}.so", [UNIT, *(file.name for file in files if file.name != inside)])
    if code_file is None:
        raise ValueError(f"{path}: a unit holds machine code: {why}")
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as unit:
        unit.writestr("modelDescription.xml", _description(about, token, variables))
        unit.writestr(f"binaries/{FORMS[about.form]}/{name}.so", (folder / code_file).read_bytes())
    write_whole(path, held.getvalue())


def _variables(source: Any, plan: Any) -> Iterator[Variable]:
    """Yield the FMU's variables; a variable's value reference is its position in this sequence."""
    joints = range(plan.arm.n_links)
    yield Variable("time", "TIME", 0, "s", "since the start")
    # inputs: torques (N m) or scaled actions
    torque = plan.action_mode == "torque"
    for k in joints:
        what = "asked of the motor, through a period" if torque else f'action_mode "{plan.action_mode}", within +-1'
        yield Variable(f"{'torque' if torque else 'action'}[{k}]", "INPUT", k, "N m" if torque else "", what, 0.0)
    for k, one in enumerate(source.parameters):
        yield Variable(one.name, "PARAMETER", k, one.unit, f"{one.meaning}, tunable", *one[3:6])
    angle, target, vibration = source.farthest
    for k in joints:
        yield Variable(f"start_angle[{k}]", "ANGLE", k, "rad", "of the joint, at the start", 0.0, -angle, angle)
    # target: angles (rad), or a point in the plane (m) inside the reach
    length, point = plan.arm.total_length, source.point
    what = "of the joint where the rigid arm's tip reaches the target" if source.aims_at_joints else "of the task"
    first: Sequence[float] = (0.5,) * len(joints)
    if point:
        near, far = source.reach
        inside = near <= 0.67 * length <= far
        first = (0.6 * length, 0.3 * length) if inside else plan.kind.target.reached(plan.arm, first)
    for k, value in enumerate(first):
        yield Variable(f"target[{k}]", "TARGET", k, "m" if point else "rad", what, value, -target, target)
    what = "tip deflection over the arm's length, at the start"
    yield Variable("start_vibration", "VIBRATION", 0, "", what, 0.0, 0.0 - vibration, vibration)
    yield Variable("seed", "SEED", 0, "", "that sensor noise follows from", 0)
    # outputs: entries of info, link poses, then the observation
    at = 0
    for field, shape in zip(INFO.fields, INFO.shapes(**source.sizes), strict=True):
        for word, unit, meaning in _info_variables(field, shape):
            if field.name not in LEFT_OUT:
                yield Variable(word, "INFO", at, unit, meaning)
            at += 1
    posed = list(reading_of(plan.arm).pose_entries())
    for link in joints:
        for k, (word, unit, meaning) in enumerate(posed):
            yield Variable(f"link[{link}].{word}", "POSE", len(posed) * link + k, unit, f"link {link}: {meaning}")
    for k in range(source.setup.size):
        yield Variable(*_observation_variable(source.setup, k))


def _observation_variable(setup: Setup, k: int) -> tuple[str, str, int, str, str]:
    """Return (name, kind, index, unit, meaning) of entry k of an observation."""
    instant, entry = divmod(k, len(setup.names))
    past, told = "" if setup.history == 1 else f"[{instant}]", f"read by the sensors, over {setup.scales[entry]:.9g}"
    return f"observation{past}.{setup.names[entry]}", "OBSERVATION", k, "", told


def _info_variables(field: Any, shape: tuple[int, ...]) -> Iterator[tuple[str, str, str]]:
    """Yield name, unit and meaning of each number of an entry of `info` with this shape."""
    unit, meaning = field.unit if field.unit in UNITS else "", field.meaning.replace("`", "")
    # energies and motors have names of their own; other arrays have indices
    if field.name == "energies":
        yield from ((f"energy.{one.name}", one.unit, one.meaning) for one in ENERGIES.fields)
    elif field.name == "motors":
        for word, own in (("angle", "rad"), ("rate", "rad/s")):
            yield from ((f"motor_{word}[{k}]", own, "of the motor, after the ratio") for k in range(shape[1]))
    else:
        name, shape = "applied_torque" if field.name == "torque" else field.name, flat(shape)
        for place in np.ndindex(shape):
            yield f"{name}{list(place) if place else ''}".replace(" ", ""), unit, meaning


def _description(about: _About, token: str, variables: list[Variable]) -> bytes:
    """Return modelDescription.xml as bytes, in the schema of the FMI version."""
    name, form, new = about.name, about.form, about.form == "3.0"
    tree = ElementTree.Element("fmiModelDescription", {
        "fmiVersion": form, "modelName": name, "instantiationToken" if new else "guid": token,
        "description": about.what, "generationTool": f"flexarm_env {VERSION}",
        "variableNamingConvention": "flat",
    })  # fmt: skip
    states = "State" if new else "state"
    how = {
        "modelIdentifier": name, "canHandleVariableCommunicationStepSize": "true",
        f"canGetAndSetFMU{states}": "true", f"canSerializeFMU{states}": "true",
    }  # fmt: skip
    if new:
        how["fixedInternalStepSize"] = number(about.period)
    ElementTree.SubElement(tree, "CoSimulation", how)
    units = ElementTree.SubElement(tree, "UnitDefinitions")
    for unit, base in UNITS.items():
        found = ElementTree.SubElement(units, "Unit", name=unit)
        ElementTree.SubElement(found, "BaseUnit", {key: str(power) for key, power in base.items()})
    ElementTree.SubElement(
        tree, "DefaultExperiment", startTime="0", stopTime=number(about.stop), stepSize=number(about.period)
    )
    # variables; integers are those with an integer start value (the seed)
    listed = ElementTree.SubElement(tree, "ModelVariables")
    for k, one in enumerate(variables):
        told = {"name": one.name, "valueReference": str(k), "description": one.meaning, "causality": one.causality}
        whole = isinstance(one.start, int)
        kinds = {"parameter": "tunable" if one.kind == "PARAMETER" else "fixed", "input": "continuous"}
        told["variability"] = kinds.get(one.causality, "continuous")
        value = {} if one.start is None else {"start": str(one.start)}
        if one.unit:
            value["unit"] = one.unit
        if one.start is not None and not whole:
            value |= {"min": number(one.least), "max": number(one.most)}
        if new:
            ElementTree.SubElement(listed, "Int32" if whole else "Float64", told | value)
        else:
            if one.causality == "parameter":
                told["initial"] = "exact"
            found = ElementTree.SubElement(listed, "ScalarVariable", told)
            ElementTree.SubElement(found, "Integer" if whole else "Real", value)
    # dependency structure: every output; FMI 2.0 counts from 1, 3.0 names value references
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
