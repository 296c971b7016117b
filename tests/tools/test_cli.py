"""The command line: listing, help, and one clear line for what the user can mend."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from polemap.drivelog.errors import InputError
from polemap.tools import cli


def test_lists_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([]) == cli.GOOD
    listed = capsys.readouterr().out
    for verb in cli.VERBS:
        assert verb in listed


@pytest.mark.parametrize("verb", sorted(cli.VERBS))
def test_help_starts_with_examples(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([verb, "--help"]) == cli.GOOD
    text = capsys.readouterr().out
    usage, _, rest = text.partition("\n\n")
    assert usage.startswith(f"Usage: polemap {verb}")
    assert rest.lstrip().startswith("Examples:")
    assert f"polemap {verb}" in rest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["frobnicate"], "No such command"),
        (["info", "--frobnicate"], "No such option"),
        (["info"], "Missing argument"),
    ],
)
def test_wrong_usage_is_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(arguments) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_user_error_is_one_line_and_crash_is_not_hidden(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def raising(error: Exception) -> object:
        def command() -> None:
            raise error

        return type("Verb", (), {"command": staticmethod(command)})

    monkeypatch.setattr(cli, "import_module", lambda _: raising(InputError("a.csv:\n3 is NaN")))
    assert cli.run(["info"]) == cli.USER_ERROR
    assert capsys.readouterr().err == "polemap: a.csv: 3 is NaN\n"
    monkeypatch.setattr(cli, "import_module", lambda _: raising(ZeroDivisionError("a bug")))
    with pytest.raises(ZeroDivisionError):
        cli.run(["info"])


def test_alone_it_says_what_to_do_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([]) == cli.GOOD
    said = capsys.readouterr().out
    assert said.startswith("Start here:\n  polemap demo --out demo")
    for verb in re.findall(r"^  polemap (\w+)", cli.FIRST_STEPS, re.MULTILINE):
        assert verb in cli.VERBS


@pytest.mark.parametrize(
    ("shell", "words", "wanted"),
    [("bash", "polemap loc", "localize"), ("zsh", "polemap convert --write", "--write-mapping"),
     ("fish", "polemap convert --write", "--write-mapping")],
)  # fmt: skip
def test_shells_complete_verbs_and_their_options(shell: str, words: str, wanted: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "polemap"],
        env={
            **os.environ,
            "_POLEMAP_COMPLETE": f"complete_{shell}",
            "_TYPER_COMPLETE_FISH_ACTION": "get-args",
            "_TYPER_COMPLETE_ARGS": words,
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split()) - 1),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert wanted in done.stdout
    assert not done.stderr


def test_linear_algebra_has_one_thread_before_numpy_comes() -> None:
    """Unless the caller says otherwise."""
    program = """
import os, sys
from polemap.tools import cli
assert "numpy" not in sys.modules
cli.use_one_blas_thread()
import numpy as np, threadpoolctl
np.ones((8, 8)) @ np.ones((8, 8))
used = {pool["num_threads"] for pool in threadpoolctl.threadpool_info()}
print(used, os.environ["MKL_NUM_THREADS"])
"""
    clean = {name: value for name, value in os.environ.items() if name not in cli.BLAS_THREADS}
    done = subprocess.run([sys.executable, "-c", program], env={**clean, "MKL_NUM_THREADS": "3"},
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert done.stdout == "{1} 3\n"
