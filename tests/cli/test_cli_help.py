"""Help answers at once because it loads nothing that only work needs."""

from __future__ import annotations

import subprocess
import sys

import pytest
from vmf_command import CONFIGS, vmf

HEAVY = ("numpy", "scipy", "yaml", "matplotlib", "pandas", "pyarrow", "mcap", "cv2")
COMMANDS = (
    "train",
    "evaluate",
    "compare-3d",
    "study",
    "simulate",
    "solve",
    "track",
    "import",
    "info",
    "sweep",
    "table",
    "report",
)
LIGHT = ("train", "solve", "sweep", "study")


@pytest.mark.parametrize("arguments", [[], *([c] for c in LIGHT)], ids=["vmf", *LIGHT])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    # Typer itself takes pydantic for the options of a command, not for the list of commands.
    heavy = HEAVY if arguments else (*HEAVY, "pydantic")
    code = (
        "import sys; from vmf.cli import main\n"
        f"sys.argv = ['vmf', *{arguments!r}, '--help']\n"
        "try: main()\n"
        "except SystemExit as end: code = end.code\n"
        f"loaded = [m for m in {heavy!r} if m in sys.modules]\n"
        "print('loaded:', loaded, 'code:', code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("loaded: [] code: 0\n"), done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_and_is_listed(command: str) -> None:
    assert command in vmf("--help").out
    said = vmf(command, "--help")
    assert (said.code, said.err) == (0, "")
    assert f"vmf {command}" in said.out


def test_help_shows_worked_examples_that_exist() -> None:
    shown = [word for word in vmf("--help").out.split() if word.startswith("configs/")]
    assert shown
    for name in shown:
        assert (CONFIGS.parent / name).exists()


def test_python_m_vmf_is_the_same_program() -> None:
    done = subprocess.run([sys.executable, "-m", "vmf", "info", "nowhere"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [vmf("info", "nowhere").refused()]


def test_a_wrong_command_or_option_is_the_users_mistake() -> None:
    assert vmf("trian").code == 2
    assert vmf("train").code == 2
    assert vmf("train", "x.yaml", "--jobs", "-1").code == 2
    assert vmf("simulate", "x.yaml").code == 2
