"""Arguments, messages, exit codes, progress; no physics.

Results go to stdout, progress and messages to stderr. Heavy libraries are imported only by the
commands that use them, so that `--help` answers at once.

Exit codes: 0 done; 1 the run failed; 2 wrong usage or case; 3 a [check] was missed;
130 interrupted, by Ctrl-C or SIGTERM, with the frames so far kept.
"""

import argparse
import difflib
import gc
import io
import logging
import os
import re
import signal
import sys
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import NoReturn

import particlerb
from particlerb.cli import exit_codes as ends
from particlerb.cli.arguments import COMMANDS
from particlerb.cli.exit_codes import DONE, FAILED, INTERRUPTED, Ending, tamed
from particlerb.cli.guard import guarded, wants_guard

_EPILOG = """\
CASE is a TOML file, or the name of one in ./cases or among the examples (`cases` lists them).
`python -m particlerb CASE` is short for `run CASE`.
exit codes: 0 done, 1 the run failed, 2 wrong usage or case, 3 a [check] was missed, 130 interrupted
"""


def _listed(command: str) -> str:
    """Where it says what a command takes."""
    return f"`{command} --help` lists what it takes"


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, and where it says what would be right."""
        command = self.prog.removeprefix("python -m particlerb").strip()
        told = message.removeprefix("argument ").removeprefix("the following arguments are ")
        raise Ending(f"{command}: {told}; {_listed(command)}")


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    top = _Parser(
        prog="python -m particlerb",
        description="Many rigid bodies built from mass particles.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"particlerb {particlerb.__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        sentence = f"{command.help[0].upper()}{command.help[1:]}."
        added = commands.add_parser(name, help=command.help, description=sentence)
        added.set_defaults(options_text=added.format_help)
        for add in command.options:
            add(added)
    return top


def main(words: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    words = list(sys.argv[1:] if words is None else words) or ["--help"]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks Σ shows ? and goes on
            stream.reconfigure(errors="replace")
    try:
        top = parser()
        if words[0] not in (*COMMANDS, "-h", "--help", "--version"):
            if near := difflib.get_close_matches(words[0], ("--help", "--version"), 1, 0.7):
                raise Ending(f"there is no {words[0]}; did you mean {near[0]}?")
            if not words[0].startswith("-"):
                from particlerb.cli.common import find_case

                find_case(words[0], tuple(COMMANDS))
            words.insert(0, "run")
        options = _parsed(top, words)
        options.started = time.perf_counter()
        log = logging.getLogger("particlerb")
        if not log.handlers:  # what the package logs goes to stderr, as all other messages
            log.addHandler(_ToStderr())
            log.setLevel(logging.INFO)
        gc.disable()  # what is imported stays: no garbage in it, now or at the end
        try:
            module = import_module(f"particlerb.cli.{COMMANDS[options.command].module}")
            gc.freeze()
        finally:
            gc.enable()
        code: int = getattr(module, f"{options.command}_command")(options)
        sys.stdout.flush()
        return code
    except Ending as error:
        return _complain(str(error), error.code)
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)
    except BrokenPipeError:  # the reader of stdout went away, as `head` does
        return DONE
    except MemoryError as error:
        where = f" ({error})" if str(error).startswith("rank ") else ""
        return _complain(f"out of memory: fewer bodies or particles would fit{where}", FAILED)
    except OSError as error:
        return _complain(ends.fault_text(error), ends.code_of_fault(error))


def _parsed(top: argparse.ArgumentParser, words: Sequence[str]) -> argparse.Namespace:
    """Options of a command line; a help text that cannot be written is an error.

    Raises
    ------
    Ending
        If there are words that the command does not take; with the nearest option.
    """
    try:
        options, beyond = top.parse_known_args(words)
    finally:
        sys.stdout.flush()
    if beyond:
        word = beyond[0].partition("=")[0]
        flags = re.findall(r"--[a-z-]+", options.options_text())
        near = difflib.get_close_matches(word, flags, 1, 0.75) if word.startswith("-") else []
        hint = f"did you mean {near[0]}?" if near else _listed(options.command)
        raise Ending(f"{options.command} does not take {beyond[0]}; {hint}")
    return options


def _drop_unwritten() -> None:
    """Let go of what no stream takes: Python would try again at its end, and exit with 120."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _ToStderr(logging.Handler):
    """Lines on what stderr is now."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line."""
        print(tamed(record.getMessage()), file=sys.stderr, flush=True)


def entry() -> NoReturn:
    """Run the command of this process and end it; SIGTERM ends it as Ctrl-C does."""
    _open_streams()
    warnings.formatwarning = warning_text
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    if wants_guard(sys.argv[1:]):
        sys.exit(guarded(sys.argv[1:]))
    code = main()
    _drop_unwritten()
    sys.exit(code)


def _open_streams() -> None:
    """Let closed streams lead nowhere: a file that is written must not take their place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def warning_text(message: Warning | str, *_: object, **__: object) -> str:
    """A warning as all other messages are, without its place in the sources."""
    return f"particlerb: warning: {message}\n"


def _complain(message: str, code: int) -> int:
    """Print a message to stderr."""
    text = message if ": error:" in message else f"particlerb: {message}"
    with suppress(OSError):  # where there is no room for a message, the code tells
        print(tamed(text), file=sys.stderr)
    return code
