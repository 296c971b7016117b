"""The command line: listing, help, and one clear line for what the user can mend."""

from __future__ import annotations

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
