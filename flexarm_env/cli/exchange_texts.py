"""Help texts of `flexarm export`, `flexarm import` and `flexarm schema`."""

FORMS = {"onnx": ".onnx", "c": ".c", "library": "", "fmu": ".fmu", "mjcf": ".xml", "urdf": ".urdf"}
"""Values of --to, each with the ending of the file's name; a library is a folder."""

EXPORT = """\
Export a trained policy, a controller or an arm for use without this package.

Policies (--to c, --to onnx). WHAT is a run folder, a policy.npz or a policy of the package. The actions of the exported
policy differ from those in NumPy by at most 1e-6. --to c writes one C99 file without main, in float32, with arrays of
fixed size and without memory allocation. It contains scaling, clipping, normalization and storage of previous
observations; its first lines document the function to call. --to onnx writes a model from observations (n, entries) to
actions (n, joints), for any ONNX runtime (requires: pip install onnx). A policy that contains a controller is exported
together with the controller: to C (in space with --targets), and in the plane to ONNX if it measures joint angles.

Controllers (--to c, --to fmu, with --env). WHAT is pd, zv, zvd, lqr, lqg or time_optimal (one link; --slew gives the
angle of the plan). The code is in double precision and contains the result of the design. Except for pd, gains depend
on the elbow angles and are tabulated every 0.1 rad, over the range --elbows. For two links the default is the full
range; for three links and more, --elbows is required.

Arms (--to library, --to fmu). WHAT is an environment's id, a task of the suite, or an arm (name or TOML file). The
results are bitwise equal to those in Python. --to library writes a folder with a shared library that does not need
Python, a documented header, an example, and files for CMake and pkg-config. --to fmu writes a functional mock-up unit
for co-simulation in any tool that imports FMUs. Both require Linux on x86-64 and a C compiler.

Models for other simulators (--to mjcf, --to urdf). WHAT is an arm. --to mjcf approximates each flexible link by rigid
pieces with --segments springs between them, calibrated to the arm's first natural frequency; it also writes motors,
limits, dampers and sensors. --to urdf writes rigid links. The command prints the errors of the approximation:
frequency_K_hz and chain_frequency_K_hz are natural frequencies of the arm and of the model with held joints;
tip_compliance_error is the relative error of the tip's displacement under a static force; tip_apart is the largest
distance between both tips in 1 s with a quarter of the torque limits, divided by the arm's length (requires mujoco).

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

--flexible BODY=SECTION makes the body's link flexible. SECTION is an inline TOML table with the keys of a section, as
in an arm's file. The link's mass is distributed evenly along the link; the command prints the resulting shift of the
center of mass, centre_shift_m, and inertia_ratio, the new inertia about the joint divided by the inertia of the rigid
link. You can also edit the TOML file afterwards.

  flexarm import robot.urdf --out robot.toml
  flexarm import reacher.xml --root body0 --out reacher.toml
  flexarm import ur5_robot.urdf --out ur5.toml \\
      --flexible 'upper_arm_link={diameter = 0.1, wall = 0.002, E = 70e9, rho = 2700.0, G = 26e9, kappa = 0.5}'
"""

SCHEMA = """\
Print the JSON schema (draft 2020-12) of arm files, or of scene files. Editors with TOML support use the schema to
complete and check a file whose first line names it. Rules that relate several fields are not in the schema; they are
checked when the file is read.

  flexarm schema > arm.schema.json
  #:schema arm.schema.json                        (first line of my_arm.toml)
  flexarm schema scene > scene.schema.json
"""
