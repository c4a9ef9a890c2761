"""Optional packages: imported when something needs them, never before."""

import importlib
from types import ModuleType

from ursnav_torch.errors import MissingExtraError


def import_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Import an optional package.

    Raises:
        MissingExtraError: it is not installed; the message names the extra that brings it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs the package {module} ({error}); install it with: pip install 'ursnav-torch[{extra}]'"
        ) from error
