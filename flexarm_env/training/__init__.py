"""Training, evaluation and tuning in run folders: `flexarm train`, `evaluate` and `tune`.

The programs are `train`, `evaluate`, `tune`, `export_policy` and `films`. Each has a documented dataclass `Arguments`,
a function that uses these arguments, and `main`. Stable-Baselines3 and PyTorch (the extra "train") are imported only to
create or read a model. Evaluating controllers and exported policies requires NumPy and SciPy alone.
"""
