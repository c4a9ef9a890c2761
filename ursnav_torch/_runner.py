"""What every runner does around its one call: configs, paths, progress, errors, exit codes (design: runner contract).

Exit codes: 0 all well, 1 not done, 2 wrong usage, 3 finished but some rows carry an error.
"""

import functools
import os
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import MissingMandatoryValue

from ursnav_torch._help import help_text, misspelled
from ursnav_torch.disk import disk_sentence
from ursnav_torch.errors import UrsnavError

# NumPy's products are small here and slower on two threads than on one; PyTorch has threads of its own.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_HERE = Path(__file__).resolve().parent
_COMMON_PATHS = ("out", "vid", "kidney.path", "kidney.calyces", "camera.path")
OK, NOT_DONE, WRONG_USAGE, ROWS_WITH_ERRORS = 0, 1, 2, 3


def config_dir() -> str:
    """The folder of the Hydra configs: inside the installed package, else beside it in a checkout.

    Raises:
        FileNotFoundError: neither is there, so the installation is broken.
    """
    for folder in (_HERE / "configs", _HERE.parent / "configs"):
        if folder.is_dir():
            return str(folder)
    raise FileNotFoundError(f"No configs folder in {_HERE} or beside it; install ursnav-torch again.")


def runner(
    config_name: str, paths: Sequence[str] = (), words: Sequence[str] = ()
) -> Callable[[Callable[[Any], int | None]], Callable[[], None]]:
    """Make ``task(config)`` a runner that reads its overrides from the command line.

    Args:
        config_name: the root file in ``configs/``.
        paths: keys whose values are paths, besides those that all runners share; such a value needs no
            Hydra quoting whatever characters it holds.
        words: keys that a word alone sets to true: ``live`` is ``live=true``.
    """

    def decorate(task: Callable[[Any], int | None]) -> Callable[[], None]:
        @functools.wraps(task)
        def main() -> None:
            if {"-h", "--help"} & set(sys.argv[1:]):
                print(help_text(Path(config_dir()) / f"{config_name}.yaml"))
                sys.exit(OK)
            sys.argv[1:] = [f"{argument}=true" if argument in words else argument for argument in sys.argv[1:]]
            sys.argv[1:] = [quote_path(argument, {*_COMMON_PATHS, *paths}) for argument in sys.argv[1:]]
            started = False

            def job(config: DictConfig) -> None:
                nonlocal started
                started = True
                _run(task, config)

            hydra_main = hydra.main(version_base="1.3", config_path=config_dir(), config_name=config_name)(job)
            try:
                hydra_main()
            except SystemExit as exit_:
                if not started and exit_.code not in (None, 0):
                    _tell_misspelled(config_name)
                    sys.exit(WRONG_USAGE)
                raise

        return main

    return decorate


def _tell_misspelled(config_name: str) -> None:
    """After Hydra's own message, what may have been meant; where a choice is wrong, Hydra has said it all."""
    with suppress(HydraException):
        for sentence in misspelled(Path(config_dir()) / f"{config_name}.yaml", sys.argv[1:]):
            print(f"error: {sentence}", file=sys.stderr)


def quote_path(argument: str, keys: set[str]) -> str:
    """Quote the value of ``key=value`` for Hydra's grammar when the key names a path; ``null`` stays null."""
    name, equals, value = argument.partition("=")
    if not equals or name.lstrip("+") not in keys or value == "null":
        return argument
    if name == "kidney.calyces" and value.isdecimal():  # a phantom's number of calyces, not a file of them
        return argument
    # To both grammars backslashes count only before what they escape (and at the end): there they are doubled.
    value = re.sub(r"(\\*)\$\{", r"\1\1\\${", value)
    value = re.sub(r"(\\*)'", r"\1\1\\'", value)
    value = re.sub(r"(\\+)\Z", r"\1\1", value)
    return f"{name}='{value}'"


def caller_path(value: Any) -> Path:
    """A path given by the user, relative to the caller's folder, as an absolute path."""
    return Path(str(value)).expanduser().absolute()


@contextmanager
def progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """Yield ``advance(n)``: a bar on a terminal, else a line on standard error every ten seconds."""
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True)) as bar:
            task = bar.add_task(what, total=total)
            yield lambda n: bar.advance(task, n)
        return
    done, last = 0, time.monotonic()

    def advance(n: int) -> None:
        nonlocal done, last
        done += n
        if time.monotonic() - last >= 10:
            last = time.monotonic()
            print(f"{what}: {done} of {total}", file=sys.stderr, flush=True)

    yield advance


def _run(task: Callable[[Any], int | None], config: DictConfig) -> NoReturn:
    warnings.formatwarning = lambda message, *_: f"warning: {message}\n"
    try:
        sys.exit(task(config) or OK)
    except KeyboardInterrupt:
        print(
            "interrupted: no result was replaced; the same command takes up what lies in NAME.partial, if anything.",
            file=sys.stderr,
        )
        sys.exit(NOT_DONE)
    except MissingMandatoryValue as error:
        print(f"error: {error.full_key}= is missing; give it on the command line (--help shows all).", file=sys.stderr)
        sys.exit(WRONG_USAGE)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(NOT_DONE)
    except UrsnavError as error:
        if os.environ.get("HYDRA_FULL_ERROR") == "1":
            raise
        print(f"error: {error}", file=sys.stderr)
        sys.exit(NOT_DONE)
    except Exception as error:
        if os.environ.get("HYDRA_FULL_ERROR") == "1":
            raise
        cause = _own_error(error) or disk_sentence(error)
        text = str(cause) if cause else f"{type(error).__name__}: {error} (HYDRA_FULL_ERROR=1 shows where)"
        print(f"error: {text}", file=sys.stderr)
        sys.exit(NOT_DONE)


def _own_error(error: BaseException) -> UrsnavError | None:
    """The package's own error behind one that Hydra's ``instantiate`` wrapped, if there is one."""
    seen: BaseException | None = error
    while seen is not None and not isinstance(seen, UrsnavError):
        seen = seen.__cause__ or seen.__context__
    return seen
