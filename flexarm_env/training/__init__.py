"""Training, evaluation and tuning in run folders: `flexarm train`, `evaluate` and `tune`.

The programs are the modules `train`, `evaluate`, `tune`, `export_policy` and `films`. Each module has a dataclass
`Arguments` for the command-line flags, a function that takes an instance of this class, and `main`. Only functions that
create or read a Stable-Baselines3 model import Stable-Baselines3 and PyTorch (extra "train"). Evaluating controllers
and exported policies requires only NumPy and SciPy.
"""
