"""The one family of errors that ursnav_torch raises on purpose.

A message says what was wrong, the value that was found, what is accepted and what to try next.
Runners print it as one paragraph and exit with 1.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class UrsnavError(Exception):
    """Base of every error that this package raises on purpose."""


class InputError(UrsnavError, ValueError):
    """A file or value given by the user cannot be used."""


class ShapeError(UrsnavError, ValueError):
    """An array or tensor has another shape than the function accepts."""


class FeatureError(UrsnavError):
    """An image does not show enough to be matched (too few edges, black, white)."""


class RegistrationError(UrsnavError):
    """Two frames cannot be registered from the points given."""


class MissingExtraError(UrsnavError, ImportError):
    """An optional package is not installed; the message names the extra that brings it."""


class DeviceError(UrsnavError):
    """Base of everything that goes wrong with a device."""


class DeviceNotConnectedError(DeviceError):
    """The device is not there, or ``connect()`` was not called."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """The device did not answer before the deadline."""


class DeviceProtocolError(DeviceError):
    """The device answered something that its protocol does not allow."""


@contextmanager
def naming(file: str | Path) -> Iterator[None]:
    """Within it, refusals of points that do not know where they came from begin with their file."""
    try:
        yield
    except (InputError, RegistrationError, ShapeError) as error:
        if str(file) in str(error):
            raise
        raise type(error)(f"{file}: {error}") from None
