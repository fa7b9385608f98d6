"""Training, evaluation and tuning in run folders: `flexarm train`, `evaluate` and `tune`.

The programs are `train`, `evaluate`, `tune`, `export_policy` and `films`, each with a documented dataclass `Arguments`,
a function that uses it, and `main`. Stable-Baselines3 and PyTorch (the extra "train") are imported only to create or
read a model; evaluating controllers and exported policies requires NumPy and SciPy alone.
"""
