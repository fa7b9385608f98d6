"""What the tests of training share."""

from pathlib import Path

ENV = "FlexibleArm-v0"
SMALL = {
    "n_envs": 8, "n_timesteps": 2048, "policy": "MlpPolicy", "n_steps": 64, "batch_size": 256, "n_epochs": 2,
    "gamma": 0.98, "learning_rate": "lin_1e-3", "policy_kwargs": "dict(net_arch=[16, 16], activation_fn=nn.ReLU)",
}  # fmt: skip
RUN_FILES = {
    "checkpoints", "model.zip", "policy.npz", "config.yml", "run.json", "learning_curve.csv", "learning_curve.png",
}  # fmt: skip


def file_of(folder: Path, text: dict, env: str = ENV, **more) -> Path:
    import yaml

    path = folder / "config.yml"
    path.write_text(yaml.safe_dump({env: text, **more}))
    return path


def told(main, words, monkeypatch, capsys) -> str:
    """The line on standard error of a program that must end with code 2."""
    monkeypatch.setattr("sys.argv", ["program", *words])
    try:
        code = main()
    except SystemExit as stop:
        code = stop.code
    lines = capsys.readouterr().err.splitlines()
    assert code == 2 and len(lines) == 1
    return lines[0]
