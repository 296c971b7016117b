"""The console command `polemap`: one line a verb, one handler for what goes wrong."""

from __future__ import annotations

import inspect
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module

import typer
from typer import TyperException

from polemap import __version__
from polemap.drivelog.errors import Mistakes
from polemap.errors import PolemapError, shortened
from polemap.extras import missing_extra
from polemap.tools import interrupts

# verb: (module with its function `command`, what it does)
VERBS = {
    "demo": ("demo", "The whole main job on an embedded simulated drive."),
    "simulate": ("simulate", "Write a simulated drive."),
    "info": ("info", "Say what is inside a drive or a map."),
    "new": ("new", "Write a drive folder to fill."),
    "convert": ("convert", "Write drives, runs and logs in another form."),
    "calibrate": ("calibrate", "Check and estimate the calibration of a drive."),
    "disparity": ("disparity", "Match one rectified stereo pair."),
    "odometry": ("odometry", "Follow the stereo camera of a drive."),
    "detect": ("detect", "Find the poles in the frames of a drive."),
    "train": ("train", "Train the pole classifier on drives with a known pole map."),
    "map": ("map", "Build, update or compare pole maps."),
    "localize": ("localize", "Replay a drive against a map."),
    "where": ("where", "Find a car anywhere in a map by the poles along its way."),
    "view": ("view", "Show a run in a viewer, or write the recording that viewers open."),
    "lanes": ("lanes", "Find the lane in the pictures of a drive, as a signal log."),
    "report": ("report.command", "Report repeatability and accuracy of runs."),
    "estimate": ("estimate", "Run a side-slip or velocity estimator on a signal log."),
    "study": ("study", "Rerun a source paper's simulation beside its claims."),
}
FIRST_STEPS = """\
Start here:
  polemap demo --out demo            the whole way on a simulated drive, in two minutes
  polemap info DRIVE                 what is in a drive of yours: a KITTI folder, a ROS bag, MCAP
  polemap convert LOG.csv --write-mapping MAP.yaml   a logger's CSV, NMEA or GPX becomes a drive
  polemap new DRIVE                  a drive folder to fill yourself

Then:
  polemap map DRIVE --out MAP.gpkg                    poles of a drive, on a map
  polemap localize OTHER --map MAP.gpkg --out RUN     another drive, localized in it
  polemap report RUN --out REPORT                     how well

polemap VERB --help starts with examples.
"""
GOOD, CRASH, USER_ERROR, INTERRUPTED = 0, 1, 2, 130
BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")


def _listed_only() -> None:
    """Stand for a verb that this call lists but does not run, so that its imports are saved."""


def _help_of(function: Callable[..., object], summary: str) -> str:
    """The verb's docstring, its examples first and with their line breaks kept."""
    text = inspect.getdoc(function) or summary
    head, mark, examples = text.partition("Examples:")
    if not mark:
        return text
    block, _, rest = examples.strip("\n").partition("\n\n")
    return f"\b\nExamples:\n{block}\n\n{head.strip()}\n\n{rest.strip()}".strip()


def build_app(verb: str | None) -> typer.Typer:
    """The command line with `verb` ready to run and the others listed."""
    app = typer.Typer(
        name="polemap",
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @app.callback(invoke_without_command=True)
    def root(
        context: typer.Context,
        version: bool = typer.Option(False, "--version", help="Print the version and exit."),
    ) -> None:
        """Know where the car is from the poles beside the road."""
        if version:
            typer.echo(f"polemap {__version__}")
            raise typer.Exit
        if context.invoked_subcommand is None:
            typer.echo(f"{FIRST_STEPS}\n{context.get_help()}")

    for name, (module, summary) in VERBS.items():
        function = (
            import_module(f"polemap.tools.{module}").command if name == verb else _listed_only
        )
        text = _help_of(function, summary) if name == verb else summary
        app.command(name, help=text, short_help=summary)(function)
    return app


def run(arguments: Sequence[str]) -> int:
    """Run one command line; every error that the user can mend is one line on stderr."""
    verb = next((word for word in _words(arguments) if not word.startswith("-")), None)
    try:
        result = build_app(verb)(args=list(arguments), prog_name="polemap", standalone_mode=False)
        return result if isinstance(result, int) else GOOD
    except TyperException as error:
        return _complain(error.format_message() or "--help lists the verbs")
    except Mistakes as error:
        for line in error.lines:
            _complain(line)
        return USER_ERROR
    except PolemapError as error:
        return _complain(str(error))
    except ModuleNotFoundError as error:
        missing = missing_extra(error)
        if missing is None:
            raise
        return _complain(str(missing))
    except OSError as error:
        return _complain(_system_error(error))
    except (KeyboardInterrupt, typer.Abort):
        return _interrupted(INTERRUPTED)
    except SystemExit as error:
        # what typer makes of a reader of stdout that went away
        if error.code != CRASH:
            raise
        return _complain("stdout: nobody reads it any more; results in files are whole")
    except BaseException:
        # libraries may turn the interrupt into an error of their own
        code = interrupts.exit_code()
        if code is None:
            raise
        return _interrupted(code)
    finally:
        interrupts.finished()


def _words(arguments: Sequence[str]) -> Sequence[str]:
    """The words of the call, or those that a shell asks to complete."""
    if "_POLEMAP_COMPLETE" not in os.environ:
        return arguments
    line = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS") or ""
    return line.split()[1:]


def _interrupted(code: int) -> int:
    _complain("interrupted; nothing half-written stays under a final name")
    return code


def _system_error(error: OSError) -> str:
    """What the system said, with the file that it was about."""
    names = [str(name) for name in (error.filename, error.filename2) if name is not None]
    if not names and _was_printing(error):
        names = ["stdout"]
    reason = error.strerror or str(error) or type(error).__name__
    return f"{' to '.join(names) or 'reading or writing failed'}: {reason}"


def _was_printing(error: OSError) -> bool:
    """Whether the error came out of printing: such an error names no file."""
    return any(frame.name == "echo" for frame in traceback.extract_tb(error.__traceback__))


def _complain(message: str) -> int:
    try:
        sys.stderr.write(f"polemap: {shortened(message)}\n")
        sys.stderr.flush()
    except (OSError, ValueError):
        pass  # nobody reads it; the exit code says enough
    return USER_ERROR


def _note(message: Warning | str, *_where: object, **_rest: object) -> None:
    """A warning as one line, without the place in the code that raised it."""
    sys.stderr.write(f"polemap: {shortened(f'note: {message}')}\n")


def _open_standard_streams() -> None:
    """Where a caller closed stdin, stdout or stderr, no file of ours may get its number."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))


def _flushed(code: int) -> int:
    """The exit code, once stdout has taken all; a full disk or closed pipe is told in one line."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError) as error:
        # what is still in the buffer would be tried, and complained about, once more at the end
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        reason = error.strerror if isinstance(error, OSError) else error
        return _complain(f"stdout: cannot be written ({reason})") if code == GOOD else code
    return code


def use_one_blas_thread() -> None:
    """Set threads of linear algebra to one, unless the caller has set them.

    The matrices are small, and work that is worth it runs in processes: more threads only take
    cores from these. Libraries read these variables when numpy is imported, which this precedes.
    """
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")


def main() -> None:
    """Entry point; a crash leaves its traceback and exit code 1."""
    use_one_blas_thread()
    interrupts.install()
    _open_standard_streams()
    warnings.showwarning = _note
    sys.exit(_flushed(run(sys.argv[1:])))
