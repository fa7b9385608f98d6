"""Policies trained, judged and kept in run folders; gains tuned: `flexarm train`, `evaluate` and `tune`.

The programs are `train`, `evaluate`, `tune`, `export_policy` and `films`: a documented dataclass `Arguments` each, what
takes it, and `main`. Stable-Baselines3 and PyTorch (the extra "train") are imported where a model is made or read; to
judge controllers and exported policies NumPy and SciPy are enough.
"""
