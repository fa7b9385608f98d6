"""Help texts of `flexarm export`, `flexarm import` and `flexarm schema`."""

FORMS = {"onnx": ".onnx", "c": ".c", "library": "", "fmu": ".fmu", "mjcf": ".xml", "urdf": ".urdf"}
"""Values of --to, each with the ending of the file's name; a library is a folder."""

EXPORT = """\
Export a trained policy, a controller or an arm for use without this package.

Policies (--to c, --to onnx). WHAT is a run folder, a policy.npz or a policy of the package. The exported policy agrees
with NumPy to 1e-6. --to c: one C99 file without main, in float32, with fixed-size arrays and no allocation; it includes
scaling, clipping, normalization and history, and its first lines document the function to call. --to onnx:
observations (n, entries) to actions (n, joints), for any runtime (needs: pip install onnx). A policy with a
controller inside is exported as one: to C (in space with --targets), to ONNX if it reads measured joint angles in the
plane.

Controllers (--to c, --to fmu, with --env). WHAT is pd, zv, zvd, lqr, lqg or time_optimal (its plan for --slew, one
link). The code is in double precision and contains the result of the design. Gains that depend on elbow angles (all but
those of pd) are tabulated every 0.1 rad: for two links over all angles or those of --elbows; for three links and more,
--elbows is required.

Arms (--to library, --to fmu). WHAT is an environment's id, a task of the suite, or an arm (name or TOML file). The
results equal Python's to the last bit. --to library: a folder with a shared library that needs no Python, a documented
header, an example, and files for CMake and pkg-config. --to fmu: a functional mock-up unit for co-simulation, for any
tool that imports FMI. Linux on x86-64; the library is linked by the C compiler found there.

Models of other simulators (--to mjcf, --to urdf). WHAT is an arm. The model is an approximation, and the command prints
its errors. --to mjcf: rigid pieces joined by hinges with springs, --segments of them per link, calibrated to the arm's
first frequency, with motors, limits, dampers and sensors. --to urdf: rigid links. Printed: frequency_K_hz of the arm
with its joints held, chain_frequency_K_hz of the chain; tip_compliance_error of the tip under a static load; tip_apart,
the largest distance of both tips in 1 s under a quarter of the torque limits, over the arm's length (needs mujoco).

  flexarm export two_link --to c --out two_link.c
  flexarm export runs/ppo-FlexibleArm-v0-0 --to onnx --out arm.onnx
  flexarm export lqr --to c --env FlexibleArm-v0 --out lqr.c
  flexarm export TwoLinkFlexArm-v0 --to library --out my_arm --env-kwargs '{"formulation": "geometrically_exact"}'
  flexarm export strip --to mjcf --segments 4 --out strip.xml
"""

IMPORT = """\
Convert a robot's URDF or MJCF file to an arm with rigid links: axes, frames, masses, inertias, limits, friction, rotors
and torque limits of a serial chain of hinges. Branches, loops, sliding and ball joints, springs at joints and tendons
are rejected by name. MuJoCo reads the files (pip install mujoco); a URDF's shapes are not needed.

--flexible BODY=SECTION makes the body's link flexible: SECTION is an inline TOML table with the keys of a section, as
in an arm's file. The link's mass is spread evenly; centre_shift_m and inertia_ratio compare it with the rigid link.
You can also edit the TOML file afterwards.

  flexarm import robot.urdf --out robot.toml
  flexarm import reacher.xml --root body0 --out reacher.toml
  flexarm import ur5_robot.urdf --out ur5.toml \\
      --flexible 'upper_arm_link={diameter = 0.1, wall = 0.002, E = 70e9, rho = 2700.0, G = 26e9, kappa = 0.5}'
"""

SCHEMA = """\
Print the JSON schema (draft 2020-12) of arm files, or of scene files. Editors with TOML support use it to complete and
check a file whose first line names the schema. The rules that relate several fields are checked when the file is read.

  flexarm schema > arm.schema.json
  #:schema arm.schema.json                        (first line of my_arm.toml)
  flexarm schema scene > scene.schema.json
"""
